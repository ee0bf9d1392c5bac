"""Frames as they would be if the axis stood upright and the vial turned about its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Camera, Optics, RunOut
from vialight.optics.run_out import Offset, really_seen, seen_from_the_vial, vial_centre_mm
from vialight.tomography.sinogram.resampling import spline_coefficients

_MARGIN = 8
"""Rows beside those that are read, for the splines."""


@dataclass(frozen=True)
class Straightening:
    """What has to be done to frames before they are read.

    Parameters
    ----------
    camera
        As the rig has it, for binned pixels.
    centre_mm
        x and y of the vial's axis in the object's frame.
    tilt_rad
        By which the axis leans to the right.
    distance_mm
        From pupil to axis.
    """

    camera: Camera
    centre_mm: Offset
    tilt_rad: float
    distance_mm: float

    def angles(self, angles_rad: FloatArray) -> FloatArray:
        """Return the angles that straightened frames belong to."""
        return seen_from_the_vial(angles_rad, self.centre_mm, self.distance_mm)

    def margin(self, columns: int) -> int:
        """Return how many rows to either side a row is made of."""
        return _MARGIN + int(np.ceil(columns * abs(np.sin(self.tilt_rad))))

    def frames(self, frames: Float32Array, first_row: int, angles_rad: FloatArray) -> Float32Array:
        """Return straightened frames.

        Parameters
        ----------
        frames
            (frame, row, column).
        first_row
            Of the image, that the frames begin with.
        angles_rad
            (frame,) of the stage, counter-clockwise seen from above.
        """
        if frames.shape[1] < 2:
            return frames
        camera, straight = self.camera, np.empty(frames.shape, np.float32)
        place = np.array([
            camera.axis_column, camera.optical_row - first_row, camera.pixel_mm, *self.centre_mm, self.tilt_rad,
            self.distance_mm,
        ])  # fmt: skip
        _straighten(np.asarray(frames, dtype=np.float32), np.atleast_1d(angles_rad), place, straight)
        return straight


def straightening(camera: Camera, optics: Optics | None, run_out: RunOut | None) -> Straightening | None:
    """Return what frames need, or None where all stands straight.

    Parameters
    ----------
    camera, optics
        As the rig has them; without optics there is no vial, and so no run-out.
    run_out
        Of the vial.
    """
    tilt = np.radians(camera.axis_tilt_deg or 0.0)
    centre = (0.0, 0.0) if optics is None else vial_centre_mm(run_out)
    if not tilt and centre == (0.0, 0.0):
        return None
    distance = 1e12 if optics is None else min(optics.distance_mm, 1e12)
    return Straightening(camera, centre, float(tilt), distance)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _straighten(frames: Float32Array, angles: FloatArray, place: FloatArray, straight: Float32Array) -> None:
    axis, optical_row, pixel, out_x, out_y, tilt, distance = place
    _, rows, columns = frames.shape
    for f in prange(len(frames)):
        along = frames[f].copy()
        spline_coefficients(along)
        across = along.T.copy()
        spline_coefficients(across)
        cosine, sine = np.cos(angles[f]), np.sin(angles[f])
        for r in range(rows):
            for c in range(columns):
                x, z = really_seen(
                    (c - axis) * pixel, (optical_row - r) * pixel, cosine, sine, out_x, out_y, tilt, distance
                )
                straight[f, r, c] = _read(across, axis + x / pixel, optical_row - z / pixel)


@njit(fastmath=FAST_MATH, cache=True)
def _read(coefficients: Float32Array, column: float, row: float) -> float:
    """Evaluate the cubic B-spline (column, row); beyond the image it goes on as it ends."""
    columns, rows = coefficients.shape
    column, row = min(max(column, 0.0), columns - 1.0), min(max(row, 0.0), rows - 1.0)
    c, r = min(int(column), columns - 2), min(int(row), rows - 2)
    total = 0.0
    for a in range(-1, 3):
        i = _mirrored(c + a, columns)
        weight = _spline(abs(column - c - a))
        for b in range(-1, 3):
            total += weight * _spline(abs(row - r - b)) * coefficients[i, _mirrored(r + b, rows)]
    return total


@njit(fastmath=FAST_MATH, cache=True)
def _spline(t: float) -> float:
    if t < 1:
        return 2 / 3 - t * t + t * t * t / 2
    return (2 - t) ** 3 / 6 if t < 2 else 0.0


@njit(fastmath=FAST_MATH, cache=True)
def _mirrored(index: int, count: int) -> int:
    index = abs(index)
    return index if index < count else 2 * (count - 1) - index
