"""Pages of docs/results: each is what its data say, of the weights that are shipped now; README.md links them all."""

import re
import sys
from pathlib import Path

import pytest
from pathfold.bench import candidates
from pathfold.plan import curves
from pathfold.report import write

sys.path.insert(0, str(Path(__file__).parent.parent / "benchmarks"))

import pages

RESULTS = Path(__file__).parent.parent / "docs" / "results"
MOST_FINDINGS, MOST_WORDS = 3, 3000
WRITTEN = sorted(path for path in RESULTS.rglob("*.md") if path != RESULTS / "README.md")


def name(path: Path) -> str:
    return str(path.relative_to(RESULTS))


@pytest.fixture(scope="module")
def made() -> dict[Path, str]:
    return pages.every(RESULTS)


@pytest.mark.parametrize("path", WRITTEN, ids=name)
def test_a_page_is_what_its_data_say(path: Path, made: dict[Path, str]) -> None:
    assert path in made, "is made from no data"
    assert path.read_text(encoding="utf-8") == made[path], "run: python benchmarks/pages.py"


def test_every_page_that_has_data_is_written(made: dict[Path, str]) -> None:
    assert sorted(made) == WRITTEN


@pytest.mark.parametrize("path", WRITTEN, ids=name)
def test_a_page_names_its_command(path: Path) -> None:
    commands = re.findall(
        r"^    ((?:pathfold|pathfold-train|python benchmarks/\w+\.py)(?: .+)?)$", path.read_text(), re.M
    )
    assert len(commands) == 1
    assert not re.search(r"(?:^|\s)(?:/|\.\./|~)", commands[0]), "tells of a place on one machine"


def test_pages_are_of_the_shipped_weights() -> None:
    found = pages.weights(RESULTS)
    stale = {(name(path), model) for path, model, identity in found if candidates.find(model).identity != identity}
    assert found and not stale, "measured other weights: run their commands again"


def test_plan_has_the_curves_of_the_bench(tmp_path: Path) -> None:
    measurements, _ = write.read(RESULTS / "bench")
    curves.save(tmp_path / curves.FILE, curves.samples(measurements))
    for kept in (RESULTS / "bench" / curves.FILE, curves.SHIPPED):
        assert kept.read_text() == (tmp_path / curves.FILE).read_text()


SECTIONS = re.split(r"^## ", (RESULTS / "README.md").read_text(encoding="utf-8"), flags=re.M)


def test_the_first_page_links_every_other_and_holds_no_table() -> None:
    links = [re.match(r"\[[^]]+\]\(([^)]+)\)\n", section) for section in SECTIONS[1:]]
    assert all(links), "each section is headed by the link to its page"
    assert sorted(RESULTS / link[1] for link in links if link) == WRITTEN
    assert not any(line.startswith("|") for section in SECTIONS for line in section.splitlines())


@pytest.mark.parametrize("section", SECTIONS[1:], ids=lambda section: section.splitlines()[0])
def test_a_finding_has_its_figures_from_the_page(section: str) -> None:
    head, _, text = section.partition("\n")
    page = (RESULTS / head[head.index("(") + 1 : -1]).read_text(encoding="utf-8")
    findings = re.findall(r"^- .+(?:\n  .+)*", text, re.M)
    assert 1 <= len(findings) <= MOST_FINDINGS
    figure = re.compile(r"(?<![\w.-])\d+(?:[.,]\d+)*")
    told = set(figure.findall(page))
    assert figure.findall(text), "tells nothing that could be held against the page"
    assert not [number for number in figure.findall(text) if number not in told]


def test_results_are_short() -> None:
    lines = [line for path in RESULTS.rglob("*.md") for line in path.read_text(encoding="utf-8").splitlines()]
    assert sum(len(line.split()) for line in lines if not line.startswith(("|", "    "))) < MOST_WORDS
