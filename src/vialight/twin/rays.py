"""Rays from a device into the resin, traced one surface at a time.

Nothing here is a closed form of the vial: a ray is a point and a unit vector, a surface is a cylinder about z with a
normal, and Snell's law and Fresnel's equations are applied there as vectors.  That is what lets the twin judge
`vialight.optics.refraction` and all that builds on it.

`trace_one` works in the device's own frame, whose pupil is at (0, -D, 0) and looks along +y; `trace` turns its rays
to the device's azimuth.  Lengths are in mm.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import ArrayLike, NDArray

from vialight.core.arrays import FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Optics

_GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))

RayTuple = tuple[float, float, float, float, float, float, float]


class Rays(NamedTuple):
    """Straight rays inside the resin, lab frame; NaN, with transmission 0, where a ray does not get there."""

    origin_mm: FloatArray
    """(..., xyz) where the ray enters the resin."""
    direction: FloatArray
    """(..., xyz) unit vectors, away from the device."""
    transmission: FloatArray
    """(...) share of unpolarised light that passes both faces of the glass."""


def trace(
    x_c_mm: ArrayLike,
    z_c_mm: ArrayLike,
    optics: Optics,
    *,
    azimuth_rad: float = 0.0,
    pupil: tuple[ArrayLike, ArrayLike] = (0.0, 0.0),
    focus_mm: float = 0.0,
) -> Rays:
    """Trace rays from a device's pupil through pixels, air and glass into the resin.

    Parameters
    ----------
    x_c_mm, z_c_mm
        Pixels, named by where their straight ray from the pupil's middle crosses the plane of the axis; any shapes
        that broadcast.
    optics
        The device and the vial.
    azimuth_rad
        Of the device about the axis.
    pupil
        (to the right, up) where in the pupil the ray begins, mm; for ``distance_mm = inf`` the slopes of the ray
        before the vial.  Broadcast with the pixels.
    focus_mm
        How far behind the axis, in air, the rays of one pixel from all over the pupil meet.

    Returns
    -------
    Rays
        Arrays of the broadcast shape.

    Examples
    --------
    >>> rays = trace([0.0, 6.0, 30.0], 0.0, Optics(12.4, 11.3, 1.472, 1.48, 190.0))
    >>> rays.direction[0]
    array([0., 1., 0.])
    >>> rays.transmission.round(4)
    array([0.9635, 0.9623, 0.    ])
    """
    shaped = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in (x_c_mm, z_c_mm, *pupil)))
    x_c, z_c, right, up = (np.ascontiguousarray(array).ravel() for array in shaped)
    traced = np.empty((x_c.size, 7))
    _trace_all(x_c, z_c, right, up, focus_mm, optics_array(optics), traced)
    cosine, sine = np.cos(azimuth_rad), np.sin(azimuth_rad)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    shape = shaped[0].shape
    return Rays(
        (traced[:, :3] @ turn.T).reshape(*shape, 3), (traced[:, 3:6] @ turn.T).reshape(*shape, 3),
        traced[:, 6].reshape(shape),
    )  # fmt: skip


def points_on_disk(count: int, radius_mm: float) -> NDArray[np.float64]:
    """Return (count, 2) points that share a disk evenly; one point is its middle.

    Examples
    --------
    >>> points_on_disk(1, 2.0)
    array([[0., 0.]])
    >>> float((points_on_disk(500, 2.0) ** 2).sum(axis=1).mean().round(3))  # half of the radius, squared
    2.0
    """
    if count == 1:
        return np.zeros((1, 2))
    ring = radius_mm * np.sqrt((np.arange(count) + 0.5) / count)
    angle = _GOLDEN_ANGLE * np.arange(count)
    return np.stack([ring * np.cos(angle), ring * np.sin(angle)], axis=1)


def optics_array(optics: Optics) -> FloatArray:
    """Return the optics as the kernels take them: D, R, R_i, n_glass, n_resin."""
    return np.array([
        optics.distance_mm, optics.outer_radius_mm, optics.inner_radius_mm, optics.wall_index, optics.resin_index,
    ])  # fmt: skip


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _trace_all(
    x_c: FloatArray, z_c: FloatArray, right: FloatArray, up: FloatArray, focus: float, optics: FloatArray,
    traced: FloatArray,
) -> None:  # fmt: skip
    for i in prange(len(x_c)):
        traced[i] = trace_one(x_c[i], z_c[i], right[i], up[i], focus, optics)


@njit(fastmath=FAST_MATH, cache=True)
def trace_one(x_c: float, z_c: float, right: float, up: float, focus: float, optics: FloatArray) -> RayTuple:
    """Trace one ray in the device's frame; see `trace`.

    Returns
    -------
    tuple
        Point of entry x, y, z, direction x, y, z, transmission.
    """
    distance = optics[0]
    if np.isinf(distance):
        x, z, dx, dy, dz = x_c, z_c, right, 1.0, up
    else:
        stretch = 1.0 + focus / distance
        x, z = x_c * stretch, z_c * stretch
        dx, dy, dz = x - right, focus + distance, z - up
    y = focus
    length = np.sqrt(dx * dx + dy * dy + dz * dz)
    dx, dy, dz = dx / length, dy / length, dz / length
    transmission = 1.0
    index_before = 1.0
    for surface in range(2):
        radius, index_after = optics[1 + surface], optics[3 + surface]
        # The side of the cylinder that faces the device.
        steep = dx * dx + dy * dy
        to_middle = -(x * dx + y * dy) / steep
        x, y, z = x + to_middle * dx, y + to_middle * dy, z + to_middle * dz
        inside = (radius * radius - x * x - y * y) / steep
        if not inside > 0.0:
            return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, 0.0
        half_chord = np.sqrt(inside)
        x, y, z = x - half_chord * dx, y - half_chord * dy, z - half_chord * dz
        if surface == 0 and optics[1] == optics[2]:
            continue  # no glass
        normal_x, normal_y = x / radius, y / radius
        ratio = index_before / index_after
        cosine = -(dx * normal_x + dy * normal_y)
        squared = 1.0 - ratio * ratio * (1.0 - cosine * cosine)
        if not squared > 0.0:
            return np.nan, np.nan, np.nan, np.nan, np.nan, np.nan, 0.0
        cosine_after = np.sqrt(squared)
        bend = ratio * cosine - cosine_after
        dx, dy, dz = ratio * dx + bend * normal_x, ratio * dy + bend * normal_y, ratio * dz
        across = (index_before * cosine - index_after * cosine_after) / (
            index_before * cosine + index_after * cosine_after
        )
        along = (index_after * cosine - index_before * cosine_after) / (
            index_after * cosine + index_before * cosine_after
        )
        transmission *= 1.0 - 0.5 * (across * across + along * along)
        index_before = index_after
    return x, y, z, dx, dy, dz, transmission
