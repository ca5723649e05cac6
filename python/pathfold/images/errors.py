"""What goes wrong with picture files, and OpenImageIO's own words for it."""

from pathlib import Path
from typing import Any

import OpenImageIO as oiio  # noqa: N813


class ImageError(RuntimeError):
    """A file that cannot be read; the message names it and says why."""


class OutputError(RuntimeError):
    """A file that cannot be written; nothing of it is left behind."""


def why(source: Any = oiio) -> str:
    """What OpenImageIO, or an input or output of its, says went wrong: one line, "" where it says nothing.

    It may quote a file's bytes, which need not be UTF-8: such stand as a replacement character.
    """
    try:
        text = str(source.geterror())
    except UnicodeDecodeError as error:
        text = error.object.decode("utf-8", "replace")
    return next(iter(text.strip().splitlines()), "")


def as_text(path: Path) -> str:
    """A path as OpenImageIO takes it. Raises ValueError where its bytes are not UTF-8."""
    try:
        str(path).encode()
    except UnicodeEncodeError:
        printable = str(path).encode("utf-8", "replace").decode()
        raise ValueError(f"{printable}: its name is not UTF-8, which OpenImageIO needs; rename it") from None
    return str(path)
