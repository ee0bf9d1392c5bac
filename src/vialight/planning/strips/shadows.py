"""The shadow that a square voxel throws on strips, and how much of the light that falls on it is left there."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH

TAPS = 3
"""Strips that a shadow falls on, at most, by parts: one of a voxel no wider than sqrt(2) strips has one part."""

Int32Array = NDArray[np.int32]


def parts_of(voxel: float) -> int:
    """Return in how many parts of `TAPS` strips the shadow of a voxel is found; its edge is given in strips.

    Examples
    --------
    >>> parts_of(1.0), parts_of(3.0)
    (1, 2)

    Raises
    ------
    ValueError
        It is wider than even two parts: its shadow, up to sqrt(2) voxels wide, needs a strip more than it is wide.
    """
    for parts in (1, 2):
        if math.sqrt(2) * voxel + 1 <= parts * TAPS:
            return parts
    raise ValueError(f"voxels {voxel} strips wide are too wide")


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
    count: int, start: float, cosine: float, sine: float, voxel: float, parts: int, shift: int, row: int,
    first: Int32Array, weights: Float32Array,
) -> None:  # fmt: skip
    """Find, for voxels along x, the first strip of each one's shadow and the shares of it on `TAPS` strips a part.

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
    parts
        1, or 2 for voxels wider than sqrt(2) strips; see `parts_of`.
    shift
        Added to the numbers of strips.
    row, first, weights
        ``first[row]``, (voxel,), and ``weights[row]``, (tap, voxel), are filled; of a second part the next row.
    """
    wide, narrow = abs(cosine) + abs(sine), abs(abs(cosine) - abs(sine))
    half_top = 0.5 * voxel * narrow
    # No quite upright sides: they would divide by 0.
    half_base = max(0.5 * voxel * wide, half_top + 1e-6)
    origin = start - half_base + 0.5
    whole = np.floor(origin)
    offset, step, one = np.float32(origin - whole), np.float32(voxel * cosine), np.float32(1)
    zero, two, three = np.float32(0), np.float32(2), np.float32(3)
    number = np.int32(whole + shift)
    top, base = np.float32(half_top), np.float32(half_base)
    peak, bend = np.float32(1 / (half_top + half_base)), np.float32(0.5 / (half_base - half_top))
    for k in range(count):
        at = offset + np.float32(k) * step
        strip = np.floor(at)
        end = strip - at + (one - base)  # of the first strip, from the middle of the shadow
        before = _below(end, top, base, peak, bend)
        weights[row, 0, k] = before
        first[row, k] = np.int32(strip) + number
        if parts == 1:
            behind = _below(-end - one, top, base, peak, bend)
            weights[row, 1, k], weights[row, 2, k] = max(one - before - behind, zero), behind
        else:
            two_in, three_in = _below(end + one, top, base, peak, bend), _below(end + two, top, base, peak, bend)
            two_left = _below(-end - three, top, base, peak, bend)
            one_left = _below(-end - three - one, top, base, peak, bend)
            weights[row, 1, k], weights[row, 2, k] = two_in - before, three_in - two_in
            weights[row + 1, 0, k], weights[row + 1, 1, k] = max(one - three_in - two_left, zero), two_left - one_left
            weights[row + 1, 2, k], first[row + 1, k] = one_left, first[row, k] + np.int32(TAPS)


@njit(fastmath=FAST_MATH, cache=True)
def gathered(
    count: int, start: float, cosine: float, sine: float, voxel: float, parts: int, width: int, line: int, number: int,
    first: Int32Array, weights: Float32Array, begin: Int32Array, end: Int32Array,
) -> None:  # fmt: skip
    """Find, for strips, the first voxel of a line along x that throws its shadow on each one, and the voxels' shares.

    The same shares as those of `shadows`.

    Parameters
    ----------
    count
        Strips.
    start
        Where the middle of strip 0 is, in voxels from the first one's middle.
    cosine, sine
        Of the angle; the cosine is the larger.
    voxel
        Edge, in strips.
    parts
        ``parts TAPS`` voxels hold all those of a strip.
    width
        Voxels in the line; others have no share.
    line
        Its number.
    number
        Of its first voxel among all.
    first, weights
        ``first[line parts + part]``, (strip,), and ``weights[line parts + part]``, (tap, strip), are filled.
    begin, end
        (strip,) first line of voxels with a shadow on the strip, and the one after the last: they are moved to hold
        this one.
    """
    wide, narrow = abs(cosine) + abs(sine), abs(abs(cosine) - abs(sine))
    half_top = 0.5 * voxel * narrow
    half_base = max(0.5 * voxel * wide, half_top + 1e-6)
    pitch = np.float32(voxel * abs(cosine))
    step, reach = np.float32(1 / (voxel * cosine)), np.float32((half_base + 0.5) / (voxel * abs(cosine)))
    top, base, half = np.float32(half_top), np.float32(half_base), np.float32(0.5)
    peak, bend = np.float32(1 / (half_top + half_base)), np.float32(0.5 / (half_base - half_top))
    origin, last, zero = np.float32(start), np.float32(width - 1), np.float32(0)
    for k in range(count):
        at = origin + np.float32(k) * step
        hit = at + reach > zero and at - reach < last
        begin[k] = min(begin[k], np.int32(line)) if hit else begin[k]
        end[k] = np.int32(line + 1) if hit else end[k]
    for part in range(parts):
        row, ahead, origin_number = line * parts + part, np.float32(1 + part * TAPS), np.int32(number)
        for k in range(count):
            first[row, k] = np.int32(np.floor(origin + np.float32(k) * step - reach) + ahead) + origin_number
        for tap in range(TAPS):
            for k in range(count):
                at = origin + np.float32(k) * step
                # As found above: rounded anew, what lies on the edge could fall to its other side.
                here = np.float32(first[row, k] - origin_number + np.int32(tap))
                off = abs(at - here) * pitch
                share = _below(half - off, top, base, peak, bend) - _below(-half - off, top, base, peak, bend)
                weights[row, tap, k] = share if here >= zero and here <= last else zero


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


@njit(fastmath=FAST_MATH, cache=True)
def weaken_gathered(
    count: int, row: int, low: int, first: Int32Array, weights: Float32Array, absorbed_fast: Float32Array,
    absorbed_slow: Float32Array, angle: int, slow: int, number: int, along: float, step: float, tilt: Float32Array,
    both: bool,
) -> None:  # fmt: skip
    """Weaken what `gathered` has found, as `weaken` does.

    Parameters
    ----------
    count, row, first, weights
        As there.
    low
        Number of the first strip.
    absorbed_fast, absorbed_slow, angle
        As x and y of `weaken`.
    slow, number
        Of the line: its index, and that of a voxel at index 0 of it among all.
    along, step
        t at that voxel, and from one to the next.
    tilt
        (strip,).
    both
        Take the mean of both ways.
    """
    half, one, last = np.float32(0.5), np.float32(1), absorbed_fast.shape[1] - 1
    for k in range(count):
        slope = tilt[min(max(low + k, 0), len(tilt) - 1)]
        for tap in range(TAPS):
            x = min(max(first[row, k] + tap - number, 0), last)
            share, gone = absorbed_fast[angle, x] * absorbed_slow[angle, slow], np.float32(along + x * step) * slope
            left = share / (one + gone)
            if both:
                left = half * (left + one / (share * (one - gone)))
            weights[row, tap, k] *= left


def absorbed(absorption: float, cosine: FloatArray, sine: FloatArray, x: FloatArray, y: FloatArray) -> tuple[
    Float32Array, Float32Array
]:  # fmt: skip
    """Return what x and y contribute to ``exp(-mu t)``, ``t = x sin(psi) + y cos(psi)``: (psi, x) and (psi, y)."""
    return (
        np.exp(-absorption * sine[:, None] * x).astype(np.float32),
        np.exp(-absorption * cosine[:, None] * y).astype(np.float32),
    )
