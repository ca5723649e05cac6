"""Files and folders that are written whole or not at all, and JSON that says what is wrong with it."""

import errno
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any


def write_whole(path: Path, content: bytes) -> None:
    """Leaves the file as it was, or with all of the content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(f".{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        partial.unlink(missing_ok=True)
        cure = "free some space and give the same command again" if error.errno == errno.ENOSPC else "nothing was kept"
        raise OSError(error.errno, f"cannot write {path}: {error.strerror}; {cure}") from error


def make_folder(folder: Path) -> None:
    """Raises OSError naming the folder where it cannot be made or written to."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise OSError(f"cannot write into {folder}: {error.strerror}; give another folder") from error


def read_object(path: Path, keys: Mapping[str, Any], cure: str) -> dict[str, Any]:
    """What a JSON file holds, `keys` among it, each of its type (or types, as isinstance takes them).

    Raises ValueError naming the file, its fault and the cure.
    """
    try:
        content = json.loads(path.read_bytes())
        content = content if isinstance(content, dict) else {}
        missing = [key for key in keys if key not in content]
        wrong = [key for key in keys if key in content and not isinstance(content[key], keys[key])]
    except OSError as error:
        raise ValueError(f"cannot read {path}: {error.strerror}; {cure}") from error
    except ValueError as error:
        raise ValueError(f"{path} is no JSON ({error}); {cure}") from error
    if missing:
        raise ValueError(f"{path} lacks {', '.join(missing)}; {cure}")
    if wrong:
        faults = ", ".join(f"{key}, which is {content[key]!r:.40}" for key in wrong)
        raise ValueError(f"{path} is altered: nothing can be made of {faults}; {cure}")
    return content
