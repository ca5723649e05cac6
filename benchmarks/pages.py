"""Pages of results: what a benchmark found, NAME.json, and the page that is made from it, NAME.md beside it.

    python benchmarks/pages.py [FOLDER]

makes every page in FOLDER (docs/results) anew from its data, after a word of it was changed, say.
"""

import argparse
import importlib
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from pathfold import models
from pathfold.bench.candidates import NOISY, PEERS, Candidate
from pathfold.bench.machine import machine
from pathfold.images import replacing

RESULTS = Path("docs/results")
DIGITS = 6  # significant ones of what was measured

Row = dict[str, Any]


@dataclass(frozen=True)
class Page:
    """How a benchmark tells what it found. `name` is its module's."""

    name: str
    title: str
    about: str  # what is measured and how, in a sentence or two
    tables: Callable[[Sequence[Row]], str]  # Markdown

    def text(self, data: Mapping[str, Any]) -> str:
        """The page, from what its NAME.json holds."""
        models = ", ".join(f"{name} {identity}" for name, identity in data["models"].items())
        made = f"Measured on {data['date']}, {data['machine']}" + (f"; weights: {models}." if models else ".")
        parts = [f"# {self.title}", self.about, f"    {data['command']}", made, self.tables(data["rows"])]
        return "\n\n".join(part.strip("\n") for part in parts) + "\n"


class Findings:
    """The rows of a page, kept in its NAME.json one by one, so that the same command goes on where it was stopped."""

    def __init__(self, page: Page, folder: Path, candidates: Sequence[Candidate]) -> None:
        """`folder` is where the page goes; `candidates` what is measured: the data say by which weights."""
        self._page, self._path = page, folder / f"{page.name}.json"
        folder.mkdir(parents=True, exist_ok=True)
        old = json.loads(self._path.read_text(encoding="utf-8")) if self._path.exists() else {}
        self._kept: list[Row] = old.get("rows", [])
        self._date: str = old.get("date", "")
        self._models = {c.name: c.identity for c in candidates if c.name not in (NOISY, *PEERS)}
        self.rows: list[Row] = []  # of this run
        self.fresh = False  # whether one was measured in this run

    def row(self, key: Mapping[str, Any], measure: Callable[[], Mapping[str, Any]]) -> Row:
        """The row of that key as it was found before, else with what `measure` finds now; it comes next on the page."""
        known = json.loads(json.dumps(key))
        row = next((old for old in self._kept if all(old.get(k) == value for k, value in known.items())), None)
        if row is None:
            row = known | rounded(measure())
            self._kept.append(row)
            self._date, self.fresh = datetime.now(UTC).date().isoformat(), True
            self._write(self._kept)
        self.rows.append(row)
        return row

    def finish(self) -> None:
        """Drop the rows that this run did not ask for, write the page, and print its tables."""
        page = self._page.text(self._write(self.rows))
        with replacing(self._path.with_suffix(".md")) as unfinished:
            unfinished.write_text(page, encoding="utf-8")
        print(self._page.tables(self.rows))

    def _write(self, rows: Sequence[Row]) -> Mapping[str, Any]:
        data = {"command": command(sys.argv), "date": self._date, "machine": machine(), "models": self._models}
        lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in data.items()]
        lines.append('"rows": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]")
        with replacing(self._path) as unfinished:
            unfinished.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return data | {"rows": rows}


def command(arguments: Sequence[str]) -> str:
    """How a benchmark was called. What lies outside the working folder keeps the end of its path alone, as
    SCENES/validation: where it lay is of this machine. Where the page goes is told by the page."""
    shown = ["python", *map(without_place, arguments)]
    for option in {"-o", "--output"} & {*shown}:
        del shown[shown.index(option) : shown.index(option) + 2]
    return " ".join(shown)


def without_place(argument: str) -> str:
    path = Path(argument).absolute()
    if path.is_relative_to(Path.cwd()):
        return str(path.relative_to(Path.cwd())) if path.exists() else argument
    return f"{path.parent.name.upper()}/{path.name}"


def family() -> list[str]:
    """The pathfold models that are shipped."""
    return [name for name in models.available(models.shipped_directories()) if name.startswith("pathfold")]


def rounded(value: Any) -> Any:
    """Data with every float to DIGITS significant digits."""
    if isinstance(value, Mapping):
        return {name: rounded(each) for name, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(each) for each in value]
    return float(f"{value:.{DIGITS}g}") if isinstance(value, float) else value


def every(folder: Path) -> dict[Path, str]:
    """Each page of benchmarks in a folder, and what its data say that it is."""
    found = {}
    for path in sorted(folder.glob("*.json")):
        page: Page = importlib.import_module(path.stem).PAGE
        found[path.with_suffix(".md")] = page.text(json.loads(path.read_text(encoding="utf-8")))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=RESULTS)
    for path, text in every(parser.parse_args().folder).items():
        path.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
