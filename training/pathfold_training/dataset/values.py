"""What a stored number counts as: the one way in which the numbers of a data set are read to learn from."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 1e15  # larger than any light, and its square still is a float


def known(values: NDArray[Any]) -> NDArray[Any]:
    """The same values and type, with 0 for what is not finite or beyond LARGEST: no renderer means that as light."""
    limit = min(LARGEST, float(np.finfo(values.dtype).max))
    return np.where(np.abs(values) <= limit, values, values.dtype.type(0))
