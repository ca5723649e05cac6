"""The demo: table, picture and page."""

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("jinja2")
pytest.importorskip("matplotlib")
pytest.importorskip("flip_evaluator")

from pathfold import metrics
from pathfold.bench.run import make_folder

sys.path.insert(0, str(Path(__file__).parent.parent / "tools"))

from demo import page, picture, table
from demo.__main__ import write
from demo.method import Method, best

SIZE = (24, 36)


@pytest.fixture(scope="module")
def methods() -> list[Method]:
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.2, 2, (*SIZE, 3)).astype(np.float32)
    noisy = Method("8 spp", truth * rng.uniform(0.4, 1.6, truth.shape).astype(np.float32), render_ms=700)
    clean = Method("a <model> & more", truth * np.float32(1.05), render_ms=800, denoise_ms=1234.5)
    for method in (noisy, clean):
        method.errors = metrics.compare(method.image, truth)
    return [noisy, clean, Method("reference", truth, note="2048 spp")]


def test_the_best_is_the_smallest_error_and_the_greatest_ssim(methods: list[Method]) -> None:
    assert all(best(methods, metric) is methods[1] for metric in ("rell2", "smape", "ssim", "flip"))


def test_markdown(methods: list[Method]) -> None:
    lines = table.markdown(methods[:2]).splitlines()
    assert lines[0].startswith("|  | RelL2 | SMAPE | SSIM | FLIP | render ms")
    assert lines[2].endswith("| 700 |  | 700 |")
    assert f"**{methods[1].errors['rell2']:.4f}**" in lines[3] and "1,234 | 2,034 |" in lines[3]


def test_records_are_plain_data(methods: list[Method]) -> None:
    first = json.loads(json.dumps(table.records(methods)))[0]
    assert first["rell2"] == pytest.approx(methods[0].errors["rell2"]) and first["denoise_ms"] is None


def test_picture(methods: list[Method], tmp_path: Path) -> None:
    picture.save(tmp_path / "picture.png", methods, [(2, 3, 8, 8), (10, 5, 8, 8)], 1.0)
    from matplotlib.image import imread

    pixels = imread(tmp_path / "picture.png")
    assert pixels.shape[1] > 400 and pixels[..., :3].std() > 0.05
    assert [path.name for path in tmp_path.iterdir()] == ["picture.png"]


class Page(HTMLParser):
    """Collects what a page refers to, its table and its controls."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.cells: list[str] = []
        self.controls: dict[str, dict[str, str | None]] = {}
        self._in_cell = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "action", "data")]
        if tag in ("input", "select"):
            self.controls[str(found["id"])] = found
        self._in_cell = tag == "td"

    def handle_data(self, data: str) -> None:
        if self._in_cell:
            self.cells.append(data)
            self._in_cell = False


def save(methods: list[Method], path: Path) -> str:
    page.save(
        path,
        methods,
        1.0,
        title="Title",
        lead="Lead",
        notes=["A note."],
        facts={"Scene": "made of formulas"},
        before="8 spp",
        after="reference",
    )
    return path.read_text(encoding="utf-8")


def test_the_page_needs_nothing_else(methods: list[Method], tmp_path: Path) -> None:
    text = save(methods, tmp_path / "index.html")
    parsed = Page(text)
    assert parsed.links == []  # pictures are set by the script, from the page itself
    assert not re.search(r"https?://|@import|url\(|fetch\(|XMLHttp|<link|<iframe", text)
    assert text.count("data:image/png;base64,") == 2 * len(methods)  # each picture and its error map
    assert parsed.cells[0] == "8 spp" and f"{methods[0].errors['flip']:.4f}" in parsed.cells
    assert parsed.controls["slider"]["type"] == "range"  # the keyboard moves it
    assert set(parsed.controls) == {"slider", "errors", "pick-before", "pick-after"}


def test_names_are_escaped(methods: list[Method], tmp_path: Path) -> None:
    text = save(methods, tmp_path / "index.html")
    assert "<model>" not in text and "a &lt;model&gt; &amp; more" in text


def test_the_demo_writes_its_four_files(methods: list[Method], tmp_path: Path) -> None:
    make_folder(tmp_path / "a" / "out")
    write(tmp_path / "a" / "out", methods, 8, ["A note."], {"Scene": "made of formulas"})
    names = sorted(path.name for path in (tmp_path / "a" / "out").iterdir())
    assert names == ["index.html", "picture.png", "results.json", "table.md"]
    assert "A note." in (tmp_path / "a" / "out" / "table.md").read_text()
