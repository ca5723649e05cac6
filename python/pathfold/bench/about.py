"""about.json, beside results.jsonl: by which command it was made, and what was left out."""

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from os.path import normpath
from pathlib import Path

from pathfold.images import replacing

FILE = "about.json"


@dataclass(frozen=True)
class About:
    """What the measurements themselves do not say."""

    command: str
    left_out: tuple[str, ...] = ()  # scenes and methods, and why

    def save(self, folder: Path) -> None:
        with replacing(folder / FILE) as unfinished:
            unfinished.write_text(json.dumps(asdict(self), indent=2) + "\n", encoding="utf-8")

    @staticmethod
    def read(folder: Path) -> "About":
        """What `save` wrote into a folder."""
        found = json.loads((folder / FILE).read_text(encoding="utf-8"))
        return About(found["command"], tuple(found["left_out"]))


def command(words: Sequence[str]) -> str:
    """How a command was called. Of what lies outside the working folder the end of the path is told alone, as
    SCENES/validation: results are shown elsewhere, and where it lay is of this machine."""
    return shlex.join(map(without_place, words))


def without_place(word: str) -> str:
    """A word of a command, which may be a path."""
    path = Path(normpath(Path(word).absolute()))
    if not path.is_relative_to(Path.cwd()):
        return f"{path.parent.name.upper()}/{path.name}"
    return str(path.relative_to(Path.cwd())) if Path(word).is_absolute() else word
