"""How kernels become vector instructions: what may be done to sums, how wide, in which memory, with which promises.

Every module of kernels imports this, and so settles the width before it declares the first of them: numba makes its
compiler then, for all of the process.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from llvmlite.binding import get_host_cpu_name
from numba import config, njit
from numba.core.codegen import get_host_cpu_features
from numba.core.compiler import CompilerBase, DefaultPassBuilder

from vialight.core.arrays import Float32Array

FAST_MATH = {"reassoc", "contract", "nsz", "arcp"}
"""What kernels may do to arithmetic: sums in any order, but NaN and infinity keep their meaning."""

WIDE = ("sapphirerapids", "emeraldrapids", "graniterapids")
"""Processors that keep their clock with 512-bit vectors, which the compiler avoids on them as on their forebears."""

_ASKED_FOR = (config.CPU_NAME, config.CPU_FEATURES)  # type: ignore[attr-defined]  # set as numba loads

if _ASKED_FOR == (None, None) and get_host_cpu_name() in WIDE:
    # What NUMBA_CPU_FEATURES sets, if a user does; kernels kept on disk are told apart by it.
    config.CPU_FEATURES = f"{get_host_cpu_features()},-prefer-256-bit"  # type: ignore[attr-defined, no-untyped-call]

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


def is_aligned(array: Float32Array) -> bool:
    """Return whether an array lies in one piece that begins on a cache line."""
    return array.flags.c_contiguous and array.ctypes.data % _CACHE_LINE == 0


class _NoOverlap(CompilerBase):
    """Compiles with the promise that no two arguments share memory.

    Without it, each short loop over slices begins by comparing the ends of a dozen rows with the sum's, which can take
    as long as the loop.
    """

    def define_pipelines(self) -> list[Any]:
        """Return numba's usual pipeline, with that promise."""
        self.state.flags.noalias = True
        return [DefaultPassBuilder.define_nopython_pipeline(self.state)]  # type: ignore[no-untyped-call]  # of numba


without_overlap: Callable[[Any], Any] = njit(fastmath=FAST_MATH, cache=True, pipeline_class=_NoOverlap)
"""Compile a function of arrays of which no two share memory."""
