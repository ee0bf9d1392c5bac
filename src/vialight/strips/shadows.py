"""The shadow that a square voxel throws on strips: how much of it each strip covers."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(inline="always")
def shadow_before(u: float, half_top: float, half_base: float) -> float:
    """Share of a unit-area trapezoid that lies below u; the trapezoid is the shadow of a square."""
    if u <= -half_base:
        return 0.0
    if u >= half_base:
        return 1.0
    height = 1.0 / (half_top + half_base)
    if u < -half_top:
        return 0.5 * height * (u + half_base) ** 2 / (half_base - half_top)
    if u <= half_top:
        return 0.5 * height * (half_base - half_top) + height * (u + half_top)
    return 1.0 - 0.5 * height * (half_base - u) ** 2 / (half_base - half_top)


@njit(inline="always")
def shadow(
    x: float, y: float, cosine: float, sine: float, first: float, voxel: float
) -> tuple[float, float, float, int, int]:
    """Return the shadow's middle, half its top, half its base, and the first and the last strip that it falls on."""
    wide, narrow = abs(cosine) + abs(sine), abs(abs(cosine) - abs(sine))
    half_top, half_base = 0.5 * voxel * narrow, max(0.5 * voxel * wide, 0.5 * voxel * narrow + 1e-9)
    middle = x * cosine - y * sine - first
    return (
        middle, half_top, half_base, int(np.floor(middle - half_base + 0.5)), int(np.floor(middle + half_base + 0.5)),
    )  # fmt: skip
