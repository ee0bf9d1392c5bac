"""The kernel of `exposure`: voxels gather light from images, pose by pose."""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def gather(
    light: Float32Array, shown: NDArray[np.int64], stood: FloatArray, shares: FloatArray, scale: FloatArray,
    coefficients: FloatArray, lattice: float, reach: float, xs: FloatArray, ys: FloatArray, zs: Float32Array,
    subs: FloatArray, dose: Float32Array,
) -> None:  # fmt: skip
    """Add to `dose` what images bring to voxels in as many poses.

    Parameters
    ----------
    light
        (image, column, row), with a black border.
    shown, stood, shares
        (pose,) image; (pose, 5) turn, shift and tilt as the projector sees them; (pose,) dose per level.
    scale
        Pixels per mm, and column and row, in `light`, of the axis and the optical axis.
    coefficients, lattice, reach
        See `vialight.twin.lightfield.LightField`.
    xs, ys, zs, subs
        Voxel centres, and (point, zyx) offsets of the points in each.
    dose
        (y, x, z).
    """
    _, columns, rows = light.shape
    flat = light.reshape(len(light), columns * rows)
    depth = len(zs)
    for iy in prange(len(ys)):
        cubic, z = np.empty(12, np.float32), np.empty(depth, np.float32)
        first = np.empty(depth, np.uint32)
        p, q, share = np.empty(depth, np.float32), np.empty(depth, np.float32), np.empty(depth, np.float32)
        for a in range(len(shown)):
            image = flat[shown[a]]
            cosine, sine = np.cos(stood[a, 0]), np.sin(stood[a, 0])
            shift_x, shift_y, tilt_x, tilt_y = stood[a, 1], stood[a, 2], stood[a, 3], stood[a, 4]
            upright = tilt_x == 0.0 and tilt_y == 0.0
            for ix in range(len(xs)):
                for s in range(len(subs)):
                    x_object, y_object = xs[ix] + subs[s, 2], ys[iy] + subs[s, 1]
                    x = cosine * x_object - sine * y_object
                    y = sine * x_object + cosine * y_object
                    sinks = np.float32(subs[s, 0] - tilt_x * x - tilt_y * y)
                    x, y = x + shift_x, y + shift_y
                    for iz in range(depth):
                        z[iz] = zs[iz] + sinks
                    if upright:
                        if not _look_up(coefficients, lattice, reach, x, y, cubic):
                            continue
                        _aim(z, 0, depth, cubic, scale, shares[a], columns, rows, first, p, q, share)
                    else:
                        for iz in range(depth):
                            if _look_up(coefficients, lattice, reach, x + tilt_x * z[iz], y + tilt_y * z[iz], cubic):
                                _aim(z, iz, iz + 1, cubic, scale, shares[a], columns, rows, first, p, q, share)
                            else:
                                first[iz], p[iz], q[iz], share[iz] = 0, 0, 0, 0
                    for iz in range(depth):
                        at = first[iz]
                        left = image[at] + q[iz] * (image[at + np.uint32(1)] - image[at])
                        at += np.uint32(rows)
                        right = image[at] + q[iz] * (image[at + np.uint32(1)] - image[at])
                        dose[iy, ix, iz] += share[iz] * (left + p[iz] * (right - left))


@njit(fastmath=FAST_MATH, cache=True)
def _look_up(coefficients: FloatArray, lattice: float, reach: float, x: float, y: float, cubic: Float32Array) -> bool:
    """Interpolate a light field's cubics at a place of the plan view; False where it is dark."""
    if x * x + y * y > reach * reach:
        return False
    half = len(coefficients) // 2
    u, v = x / lattice + half, y / lattice + half
    i, j = int(u), int(v)
    u, v = u - i, v - j
    for q in range(3):
        for k in range(4):
            value = (1 - v) * ((1 - u) * coefficients[j, i, q, k] + u * coefficients[j, i + 1, q, k]) + v * (
                (1 - u) * coefficients[j + 1, i, q, k] + u * coefficients[j + 1, i + 1, q, k]
            )
            if np.isnan(value):
                return False
            cubic[4 * q + k] = value
    return True


@njit(fastmath=FAST_MATH, inline="always")
def _aim(
    z: Float32Array, start: int, stop: int, cubic: Float32Array, scale: FloatArray, weight: float, columns: int,
    rows: int, first: NDArray[np.uint32], p: Float32Array, q: Float32Array, share: Float32Array,
) -> None:  # fmt: skip
    """Find, for heights above one place of the plan view, the four pixels around each ray and their weights.

    Kept apart from reading the pixels, so that this half runs in vector registers.
    """
    none = np.float32(0)
    last_column, last_row = np.float32(columns - 1.01), np.float32(rows - 1.01)
    per_mm, axis_column, optical_row = np.float32(scale[0]), np.float32(scale[1]), np.float32(scale[2])
    x0, x1, x2, x3 = cubic[0] * per_mm + axis_column, cubic[1] * per_mm, cubic[2] * per_mm, cubic[3] * per_mm
    z0, z1, z2, z3 = optical_row - cubic[4] * per_mm, cubic[5] * per_mm, cubic[6] * per_mm, cubic[7] * per_mm
    w = np.float32(weight)
    w0, w1, w2, w3 = cubic[8] * w, cubic[9] * w, cubic[10] * w, cubic[11] * w
    for i in range(start, stop):
        h = z[i]
        column = min(max(x0 + h * (x1 + h * (x2 + h * x3)), none), last_column)
        row = min(max(z0 - h * (z1 + h * (z2 + h * z3)), none), last_row)
        whole_column, whole_row = np.int32(column), np.int32(row)
        first[i] = np.uint32(whole_column * np.int32(rows) + whole_row)
        p[i], q[i] = column - np.float32(whole_column), row - np.float32(whole_row)
        share[i] = w0 + h * (w1 + h * (w2 + h * w3))
