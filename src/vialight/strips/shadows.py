"""The shadow that a square voxel throws on strips, and how much of the light that falls on it is left there."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vialight.arrays import FAST_MATH, Float32Array, FloatArray

TAPS = 3
"""Strips that a shadow falls on, at most: it is up to sqrt(2) voxels wide."""

Int32Array = NDArray[np.int32]


@njit(inline="always")
def _below(u: np.float32, top: np.float32, base: np.float32, peak: np.float32, bend: np.float32) -> np.float32:
    """Share of a trapezoid of unit area that lies below u, exactly 0 under its base: of its rise, its top, its fall."""
    rise = min(max(u, -base), -top) + base
    level = min(max(u, -top), top) + top
    fall = max(min(u, base), top) - top
    share: np.float32 = peak * (bend * (rise * rise - fall * fall) + level + fall)
    return share


# Kernels are handed whole arrays with the numbers of their rows: a view would be counted, by every thread, when it is
# made and when it is left.  They are not inlined by numba: only of a function of its own does LLVM know that its
# arrays do not overlap.
@njit(fastmath=FAST_MATH, cache=True)
def shadows(
    count: int, start: float, cosine: float, sine: float, voxel: float, shift: int, row: int, first: Int32Array,
    weights: Float32Array,
) -> None:  # fmt: skip
    """Find, for voxels along x, the first strip of each one's shadow and the shares of it on `TAPS` strips.

    Parameters
    ----------
    count
        Voxels.
    start
        Where the middle of the first one's shadow falls, in strips from the middle of strip 0.
    cosine, sine
        Of the angle.
    voxel
        Edge, in strips.
    shift
        Added to the numbers of strips.
    row, first, weights
        ``first[row]``, (voxel,), and ``weights[row]``, (tap, voxel), are filled.
    """
    wide, narrow = abs(cosine) + abs(sine), abs(abs(cosine) - abs(sine))
    half_top = 0.5 * voxel * narrow
    # No quite upright sides: they would divide by 0.
    half_base = max(0.5 * voxel * wide, half_top + 1e-6)
    origin = start - half_base + 0.5
    whole = np.floor(origin)
    offset, step, one = np.float32(origin - whole), np.float32(voxel * cosine), np.float32(1)
    zero = np.float32(0)
    number = np.int32(whole + shift)
    top, base = np.float32(half_top), np.float32(half_base)
    peak, bend = np.float32(1 / (half_top + half_base)), np.float32(0.5 / (half_base - half_top))
    for k in range(count):
        at = offset + np.float32(k) * step
        strip = np.floor(at)
        end = strip - at + (one - base)  # of the first strip, from the middle of the shadow
        before, behind = _below(end, top, base, peak, bend), _below(-end - one, top, base, peak, bend)
        weights[row, 0, k], weights[row, 1, k], weights[row, 2, k] = before, max(one - before - behind, zero), behind
        first[row, k] = np.int32(strip) + number


@njit(fastmath=FAST_MATH, cache=True)
def weaken(
    count: int, row: int, weights: Float32Array, absorbed_x: Float32Array, absorbed_y: Float32Array, angle: int,
    x: int, y: int, along: float, step: float, slopes: Float32Array, both: bool,
) -> None:  # fmt: skip
    """Multiply shares by what is left of the light at the voxels, absorbed and spread; 1 on the axis.

    Parameters
    ----------
    count, row, weights
        ``weights[row]`` are (tap, voxel).
    absorbed_x, absorbed_y
        (psi, x) and (psi, y): what x and y contribute to ``exp(-mu t)``.
    angle, x, y
        Indices into these; x is the first voxel's.
    along, step
        t at the first voxel, and from one to the next.
    slopes
        (tap, voxel) tilt of the light there.
    both
        Take the mean of both ways.
    """
    half, one = np.float32(0.5), np.float32(1)
    for k in range(count):
        share, gone = absorbed_x[angle, x + k] * absorbed_y[angle, y], np.float32(along + k * step)
        for tap in range(TAPS):
            left = share / (one + gone * slopes[tap, k])
            if both:
                left = half * (left + one / (share * (one - gone * slopes[tap, k])))
            weights[row, tap, k] *= left


def absorbed(absorption: float, cosine: FloatArray, sine: FloatArray, x: FloatArray, y: FloatArray) -> tuple[
    Float32Array, Float32Array
]:  # fmt: skip
    """Return what x and y contribute to ``exp(-mu t)``, ``t = x sin(psi) + y cos(psi)``: (psi, x) and (psi, y)."""
    return (
        np.exp(-absorption * sine[:, None] * x).astype(np.float32),
        np.exp(-absorption * cosine[:, None] * y).astype(np.float32),
    )
