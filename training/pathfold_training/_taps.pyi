from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

def sum_taps(
    logits: NDArray[np.float32],
    first: int,
    source: NDArray[np.float32],
    offsets: Sequence[tuple[int, int]],
    threads: int,
) -> NDArray[np.float32]: ...
def spread_taps(
    logits: NDArray[np.float32],
    first: int,
    source: NDArray[np.float32],
    gradient: NDArray[np.float32],
    of_logits: NDArray[np.float32],
    offsets: Sequence[tuple[int, int]],
    threads: int,
) -> NDArray[np.float32]: ...
