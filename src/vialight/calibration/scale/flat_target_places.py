"""Where a camera's rays meet a flat target, in air or through the vial."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.optics.refraction import camera_to_virtual

PIXEL, ROW, COLUMN, DISTORTION, DISTANCE, INDEX, ROLL, RIGHT, UP, DEPTH, YAW, PITCH = range(12)
"""Of the vector that is fitted: logarithms of pixel, distance and index over the rig's; rows, columns; rad; mm."""

_SMALL = 0.1
"""Pixels, over which slopes are taken."""


@dataclass(frozen=True)
class Known:
    """What is known before the target is looked at.

    Parameters
    ----------
    pitch_mm
        From point to point.
    camera, optics
        As the rig has them; no optics for a target in air.
    image_shape
        (rows, columns).
    depth_std_mm
        Standard uncertainty of the target's plane being that of the axis.
    distance_std, index_std
        Of the camera's distance and the resin's index, as shares.
    """

    pitch_mm: float
    camera: Camera
    optics: Optics | None
    image_shape: tuple[int, int]
    depth_std_mm: float = 0.3
    distance_std: float = 0.05
    index_std: float = 0.003


def places_on_target(
    values: FloatArray, columns: FloatArray, rows: FloatArray, turned_rad: FloatArray, known: Known
) -> FloatArray:
    """Return (..., 2) where rays of pixels meet a target, to the right and up from its first point, mm.

    Parameters
    ----------
    values
        See `PIXEL` and those that follow.
    columns, rows
        As seen.
    turned_rad
        Of the stage since the view that faces the camera.
    known
        What `values` is relative to.
    """
    origin, course = _rays(values, columns, rows, known)
    cosine, sine = np.cos(turned_rad), np.sin(turned_rad)
    origin, course = (
        np.stack(
            [cosine * ray[..., 0] + sine * ray[..., 1], cosine * ray[..., 1] - sine * ray[..., 0], ray[..., 2]], -1
        )
        for ray in (origin, course)
    )
    right, normal, up = Rotation.from_euler("yxz", values[[ROLL, PITCH, YAW]]).as_matrix().T
    along = (values[DEPTH] - origin @ normal) / (course @ normal)
    met = origin + along[..., None] * course
    return np.stack([met @ right - values[RIGHT], met @ up - values[UP]], axis=-1)


def slopes_on_target(
    values: FloatArray, columns: FloatArray, rows: FloatArray, turned_rad: FloatArray, known: Known
) -> FloatArray:
    """Return (..., 2, 2) mm to the right and up by which that moves with each column and row; 0 where none is met."""
    here, right, down = (
        places_on_target(values, columns + a, rows + b, turned_rad, known)
        for a, b in ((0.0, 0.0), (_SMALL, 0.0), (0.0, _SMALL))
    )
    return np.asarray(np.nan_to_num(np.stack([right - here, down - here], axis=-1) / _SMALL))


def _rays(values: FloatArray, columns: FloatArray, rows: FloatArray, known: Known) -> tuple[FloatArray, FloatArray]:
    """Return a point and the direction of each pixel's ray where the target is."""
    camera, width = known.camera, known.image_shape[1]
    reach = width / 2
    from_middle = np.stack([columns - (width - 1) / 2, rows - values[ROW]], axis=-1)
    bent = values[DISTORTION] * (from_middle**2).sum(axis=-1, keepdims=True) * from_middle / reach**3
    column, row = columns - bent[..., 0], rows - bent[..., 1]
    pixel = camera.pixel_mm * np.exp(values[PIXEL])
    x_c, z_c = (column - values[COLUMN]) * pixel, (values[ROW] - row) * pixel
    distance = (np.inf if camera.distance_mm is None else camera.distance_mm) * np.exp(values[DISTANCE])
    if known.optics is None:
        ones = np.ones_like(x_c)
        return np.stack([x_c, 0 * ones, z_c], axis=-1), np.stack([x_c / distance, ones, z_c / distance], axis=-1)
    optics = replace(
        known.optics, distance_mm=float(distance), resin_index=known.optics.resin_index * float(np.exp(values[INDEX]))
    )
    rays = camera_to_virtual(x_c, z_c, optics)
    cosine, sine = np.cos(rays.direction_rad), np.sin(rays.direction_rad)
    return (
        np.stack([rays.virtual_x_mm * cosine, -rays.virtual_x_mm * sine, rays.mid_height_mm], axis=-1),
        np.stack([sine, cosine, rays.slope], axis=-1),
    )
