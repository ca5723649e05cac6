"""A noisy frame to denoise, and what it took to render."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from pathfold.bench.candidates import Candidate

Buffers = dict[str, NDArray[Any]]


@dataclass(frozen=True)
class Shot:
    """A noisy frame: its buffers, and the milliseconds that each timed rendering took.

    `render_ms` is by the number of samples of a pixel whose paths were recorded.
    """

    buffers: Buffers
    spp: int
    render_ms: Mapping[int, list[float]]

    def rendering_for(self, candidate: Candidate) -> list[float]:
        """The times of renderings that recorded what the candidate looks at."""
        return self.render_ms.get(min(candidate.path_samples, self.spp), [])
