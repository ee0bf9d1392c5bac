"""Memory that vectors read without crossing cache lines."""

from __future__ import annotations

import numpy as np

from vialight.arrays import Float32Array

_CACHE_LINE = 64
"""Bytes.  A vector that lies across two lines takes two reads; NumPy begins large arrays 16 bytes into a line."""

FLOATS_A_LINE = _CACHE_LINE // 4


def padded_depth(depth: int) -> int:
    """Return how many slices fill whole cache lines.

    Examples
    --------
    >>> padded_depth(300)
    304
    """
    return depth + -depth % FLOATS_A_LINE


def aligned_zeros(shape: tuple[int, ...]) -> Float32Array:
    """Return zeros that begin on a cache line; memory that is never written takes no room."""
    size = int(np.prod(shape))
    room = np.zeros(size + FLOATS_A_LINE, np.float32)
    start = -room.ctypes.data % _CACHE_LINE // 4
    return room[start : start + size].reshape(shape)
