"""Pages of results: what a benchmark found, NAME.json, and the page that is made from it, NAME.md beside it.

    python benchmarks/pages.py [FOLDER]

makes every page in FOLDER (docs/results) anew from its data, those of `pathfold bench`, `pathfold-train evaluate` and
`pathfold plan --check` too.
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
from pathfold.bench import about, results
from pathfold.bench.candidates import NOISY, PEERS, Candidate
from pathfold.bench.machine import machine
from pathfold.images import replacing
from pathfold.plan import check, curves
from pathfold.report import write
from pathfold_training.release import evaluate

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
        old = read(self._path) if self._path.exists() else {"date": "", "machine": ""}
        same = old["machine"] == machine()  # a page is of one machine
        self._kept: list[Row] = old["rows"] if same else []
        self._made = {name: old[name] for name in ("date", "machine")}
        self._models = {c.name: c.identity for c in candidates if is_model(c.name)}
        self.rows: list[Row] = []  # of this run
        self.fresh = False  # whether one was measured in this run

    def row(self, key: Mapping[str, Any], measure: Callable[[], Mapping[str, Any]]) -> Row:
        """The row of that key as it was found before, else with what `measure` finds now; it comes next on the page."""
        known = json.loads(json.dumps(key))
        row = next((old for old in self._kept if all(old.get(k) == value for k, value in known.items())), None)
        if row is None:
            row = known | rounded(measure())
            self._kept.append(row)
            self._made, self.fresh = {"date": datetime.now(UTC).date().isoformat(), "machine": machine()}, True
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
        data = {"command": command(sys.argv), **self._made, "models": self._models}
        lines = [f"{json.dumps(name)}: {json.dumps(value)}" for name, value in data.items()]
        lines.append('"rows": [\n' + ",\n".join(json.dumps(row) for row in rows) + "\n]")
        with replacing(self._path) as unfinished:
            unfinished.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
        return data | {"rows": rows}


def command(arguments: Sequence[str]) -> str:
    """How a benchmark was called; where its page goes is told by the page."""
    words = ["python", *arguments]
    for option in {"-o", "--output"} & {*words}:
        del words[words.index(option) : words.index(option) + 2]
    return about.command(words)


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


def read(path: Path) -> dict[str, Any]:
    """A page's data. Raises ValueError naming a file that holds none."""
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        whole = {"command", "date", "machine", "models", "rows"} <= data.keys()
    except (ValueError, AttributeError):
        whole = False
    if not whole:
        raise ValueError(f"{path} holds no page's data, or is damaged: remove it, and run its benchmark again")
    return data


def every(folder: Path) -> dict[Path, str]:
    """Each page in a folder of results, and what its data say that it is.

    Raises ValueError naming data that are damaged, or that no benchmark makes.
    """
    if not folder.is_dir():
        raise ValueError(f"there is no folder {folder}")
    found = {}
    for path in sorted(folder.glob("*.json")):
        if not Path(__file__).with_name(f"{path.stem}.py").is_file():
            raise ValueError(f"{path}: there is no benchmark {path.stem}; remove it")
        page: Page = importlib.import_module(path.stem).PAGE
        found[path.with_suffix(".md")] = page.text(read(path))
    for path in sorted(folder.glob(f"*/{about.FILE}")):
        measurements, made = write.read(path.parent)
        table = evaluate.table if made.command.startswith("pathfold-train evaluate") else write.markdown
        found[path.with_name(write.TABLE)] = table(measurements, made)
    found[folder / "plan.md"] = check.markdown(curves.read(curves.SHIPPED), "pathfold plan --check")
    return found


def weights(folder: Path) -> set[tuple[Path, str, str]]:
    """The data of results, the models that they are of, and the identities of these when they were measured."""
    found = set()
    for path in folder.glob("*.json"):
        found |= {(path, *model) for model in read(path)["models"].items()}
    for path in folder.glob("*/results.jsonl"):
        found |= {(path, m.method, m.identity) for m in results.read(path).values() if is_model(m.method)}
    return found


def is_model(method: str) -> bool:
    return method not in (NOISY, *PEERS)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, nargs="?", default=RESULTS)
    try:
        for path, text in every(parser.parse_args().folder).items():
            path.write_text(text, encoding="utf-8")
    except ValueError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
