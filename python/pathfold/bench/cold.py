"""The first frame in a fresh process: how long it takes with all that is loaded for it, and the peak memory.

python -m pathfold.bench.cold CANDIDATE FOLDER: the buffers are FOLDER/*.npy; prints one line of JSON.
"""

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pathfold import memory
from pathfold.bench import candidates, peers

TIMEOUT = 1800  # seconds


class ColdError(RuntimeError):
    """The process died or failed; the message says how."""


def measure(candidate: candidates.Candidate, buffers: Mapping[str, NDArray[Any]]) -> tuple[float, float]:
    """Milliseconds from nothing loaded to the first picture, and the MB that this needs above its inputs.

    The inputs are in memory before the clock starts. Raises ColdError.
    """
    taken = first_frame(candidate, buffers)
    return taken["ms"], taken["mb"]


def first_frame(candidate: candidates.Candidate, buffers: Mapping[str, NDArray[Any]]) -> dict[str, float]:
    """`measure`'s two as "ms" and "mb", and "total_mb", the peak of the whole process. Raises ColdError."""
    with TemporaryDirectory(prefix="pathfold-") as folder:
        for name in candidate.reads & buffers.keys():
            np.save(Path(folder) / f"{name}.npy", buffers[name])
        command = [sys.executable, "-m", __name__, candidate.argument, folder]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=TIMEOUT)
        except subprocess.TimeoutExpired:
            raise ColdError(f"no picture after {TIMEOUT} s") from None
    if done.returncode:
        lines = done.stderr.strip().splitlines()
        killed = f"its process ended with signal {-done.returncode}" if done.returncode < 0 else "it failed"
        raise ColdError(lines[-1] if lines and done.returncode > 0 else killed)
    taken: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return taken


def main(argument: str, folder: Path) -> None:
    peers.keep_torch_out()
    buffers = {path.name.removesuffix(".npy"): np.load(path) for path in sorted(folder.glob("*.npy"))}
    candidate = candidates.find(argument)
    before = memory.forget_peak()
    start = perf_counter()
    candidate.load()(buffers, None, 0)
    milliseconds = 1000 * (perf_counter() - start)
    peak = memory.peak()
    print(json.dumps({"ms": milliseconds, "mb": max(0.0, peak - before), "total_mb": peak}))


if __name__ == "__main__":
    main(sys.argv[1], Path(sys.argv[2]))
