"""How much memory this process holds."""

import ctypes
import sys
from pathlib import Path

_STATUS = Path("/proc/self/status")
MEBIBYTE = 2**20


def can_be_watched() -> bool:
    """Whether the system tells what a process holds and held (Linux)."""
    return _STATUS.exists()


def in_use() -> float:
    """The MB that are resident now; where the system does not say (it is no Linux), the most so far."""
    _give_back()
    return _entry("VmRSS:") or peak()


def peak() -> float:
    """The most MB that were resident at a time, since `forget_peak` where that works."""
    if found := _entry("VmHWM:"):
        return found
    import resource  # not on Windows

    unit = MEBIBYTE if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def forget_peak() -> float:
    """Start counting the peak anew where the system can (Linux); the MB in use now."""
    _give_back()
    try:
        Path("/proc/self/clear_refs").write_text("5")
    except OSError:
        return peak()
    return peak()


def _give_back() -> None:
    """What the C library keeps free for later looks like memory in use, and hides what is taken from it next."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
    if trim is not None:  # glibc
        trim(0)


def _entry(name: str) -> float:
    lines = _STATUS.read_text().splitlines() if _STATUS.exists() else []
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith(name)), 0.0)
