"""Output files that appear whole or not at all."""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import OpenImageIO as oiio  # noqa: N813

from pathfold.images.errors import OutputError, as_text, why

_LINEAR = (".exr", ".hdr", ".pfm", ".tif", ".tiff")  # what holds linear floats; others take 8 or 16 bits for a display


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """A temporary path beside `path` that takes its place on success and is removed on failure.

    A link stays: what it leads to is replaced. A file that was there keeps its permissions.
    """
    final = Path(os.path.realpath(path))
    unfinished = _placeholder(final)
    try:
        yield unfinished
        unfinished.chmod(final.stat().st_mode & 0o777 if final.is_file() else 0o666 & ~_umask())
        unfinished.replace(final)
    except OSError as error:
        raise OutputError(f"{path}: cannot be written: {error.strerror}") from error
    except OutputError as error:
        raise OutputError(str(error).replace(str(unfinished), str(path))) from error
    finally:
        with suppress(FileNotFoundError):
            unfinished.unlink()


def check_output(path: str | os.PathLike[str]) -> None:
    """Raise OutputError now, not after long work, where a picture could not be written to `path`."""
    try:
        known = oiio.ImageOutput.create(as_text(Path(path))) is not None
    except ValueError as error:
        raise OutputError(str(error)) from error
    if not known:
        raise OutputError(f"{path}: {why()}; name it .exr")
    if Path(path).suffix.lower() not in _LINEAR:
        raise OutputError(f"{path}: linear radiance needs an EXR; name it {Path(path).with_suffix('.exr').name}")
    check_writable(path)


def check_writable(path: str | os.PathLike[str]) -> None:
    """Raise OutputError where a file of any kind could not be written to `path`."""
    _placeholder(Path(os.path.realpath(path))).unlink()


def _placeholder(final: Path) -> Path:
    """An empty file beside `final`, of the same type."""
    if final.is_dir():
        raise OutputError(f"{final}: is a folder; name a file")
    if final.exists() and not final.is_file():
        raise OutputError(f"{final}: is no file that can be replaced; name another")
    try:
        handle, name = tempfile.mkstemp(prefix=f".{final.stem[:40]}-", suffix=final.suffix, dir=final.parent)
    except OSError as error:
        raise OutputError(f"{final}: cannot be written: {error.strerror}: '{final.parent}'") from error
    os.close(handle)
    return Path(name)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
