"""The README's table of results: its cells are those of the pages in docs/results."""

from pathlib import Path

from pathfold.models import DEFAULT

ROOT = Path(__file__).parent.parent
PEER = "oidn"


def rows(page: Path, after: str = "") -> list[list[str]]:
    """The cells of a page's first table behind some text, its rule left out."""
    lines = page.read_text(encoding="utf-8").split(after, 1)[1] if after else page.read_text(encoding="utf-8")
    found: list[list[str]] = []
    for line in lines.splitlines():
        if line.startswith("|"):
            found.append([cell.strip() for cell in line.strip("|").split("|")])
        elif found:
            break
    return [found[0], *found[2:]]


def test_the_table_is_what_the_pages_say() -> None:
    results = ROOT / "docs" / "results"
    bench, wide = rows(results / "bench" / "table.md", f"## Against {PEER}\n"), rows(results / "resolution.md")
    columns = [
        bench[0].index(name) for name in ("RelL2, same spp", "FLIP, same spp", "denoise time", "RelL2, same time")
    ]
    expected = {row[1]: [row[1], *(row[column] for column in columns)] for row in bench[1:] if row[0] == DEFAULT}
    for row in wide[1:]:
        if row[0] == DEFAULT:
            expected[row[1]].append(row[wide[0].index(f"/ {PEER}")])
    shown = rows(ROOT / "README.md")[1:]
    assert [row[0] for row in shown] == ["2", "8", "32"]
    assert shown == [expected[row[0]] for row in shown]
