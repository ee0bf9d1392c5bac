"""Linear interpolation along a projection, as every backprojection here reads it."""

from __future__ import annotations

import numpy as np
from numba import njit

from vialight.core.compiling import FAST_MATH


@njit(inline="always", fastmath=FAST_MATH)
def tap(position: float, samples: int) -> tuple[int, np.float32, np.float32]:
    """Return index and the two weights of linear interpolation; weights 0 outside the samples.  Free of branches."""
    index = max(min(int(position), samples - 2), 0)
    weight = np.float32(position - index)
    inside = np.float32(1) if 0 <= position <= samples - 1 else np.float32(0)
    return index, inside * (np.float32(1) - weight), inside * weight
