"""The files that a name on a command line stands for: `####` is a frame number."""

import re
from itertools import pairwise
from pathlib import Path

from pathfold.cli.console import InputError

_NOTATIONS = r"%0?(\d*)d|(@+)"  # of other programs


def expand(source: Path, output: Path) -> list[tuple[Path, Path]]:
    """The files that a name stands for, by frame number, with their outputs; a file of that very name is that file.

    Raises InputError, which says how a sequence is written.
    """
    run = re.search(r"#+", source.name)
    if source.is_file() or run is None:
        if run is None and "#" in output.name:
            raise InputError(f"{output}: # stands for a frame number, which {source.name} has not; name one file")
        if not source.exists() and (hashes := re.sub(_NOTATIONS, _hashes, source.name)) != source.name:
            raise InputError(f"{source}: no such file; a sequence is written with # for its digits: {hashes}")
        return [(source, output)]
    if "#" not in output.name:
        raise InputError(f"{output}: a sequence needs {run.group()} in the name of its output, too")
    frames = sorted((int(found), path) for path, found in _listed(source, _number(run.group())))
    if not frames:
        skipped = f"; there is {', '.join(near)}" if (near := similar(source, output)) else ""
        raise InputError(f"{source}: no file of that name with a frame number{skipped}")
    for (frame, one), (other_frame, other) in pairwise(frames):
        if frame == other_frame:
            raise InputError(f"{one.name} and {other.name} are both frame {frame}; move one of them away")
    width = len(re.search(r"#+", output.name).group())  # type: ignore[union-attr]
    return [
        (path, output.with_name(re.sub(r"#+", f"{frame:0{width}d}", output.name, count=1))) for frame, path in frames
    ]


def similar(source: Path, output: Path) -> list[str]:
    """Files whose names differ from the sequence's by more than a frame number of enough digits, by name."""
    run = re.search(r"#+", source.name)
    if run is None or source.is_file():
        return []
    taken = {path for path, _ in _listed(source, _number(run.group()))}
    if output.parent.resolve() == source.parent.resolve() and (own := re.search(r"#+", output.name)):
        taken |= {path for path, _ in _listed(output, _number(own.group()))}
    anything = r"[^/]*\d[^/]*" if source.name[: run.start()] else r"-?\d+"
    return sorted(path.name for path, _ in _listed(source, anything) if path not in taken)


def _hashes(found: re.Match[str]) -> str:
    return "#" * (len(found[2]) if found[2] else int(found[1] or 1))


def _number(run: str) -> str:
    """At least so many digits; a sign counts as one of them to some programs, and to some it does not."""
    return rf"\d{{{len(run)},}}|-\d{{{max(1, len(run) - 1)},}}"


def _listed(pattern: Path, number: str) -> list[tuple[Path, str]]:
    """The files beside `pattern` whose names have `number` in place of its first #s, and what they have there."""
    before, after = re.split(r"#+", pattern.name, maxsplit=1)
    name = re.compile(f"{re.escape(before)}({number}){re.escape(after)}", re.DOTALL)
    beside = pattern.parent.iterdir() if pattern.parent.is_dir() else ()
    return [(path, found.group(1)) for path in beside if (found := name.fullmatch(path.name)) and path.is_file()]
