"""How the object and the vial stand in the lab, as devices round it see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import FloatArray


@dataclass(frozen=True)
class Pose:
    """The object turned, and off the ideal axis by the stage's faults.

    A point goes from the object to the lab by a turn of `angle_rad` about z, a small rotation that tilts the axis by
    `tilt_rad` towards lab x and y, and a shift.

    Parameters
    ----------
    angle_rad
        Turn, counter-clockwise seen from above.
    shift_mm
        Lab x and y of the axis at z = 0.
    tilt_rad
        How far the axis leans towards lab x and y, small.

    Examples
    --------
    >>> Pose(0.5, shift_mm=(1.0, 0.0)).seen_from(np.pi / 2)[1:3]  # what is lab x lies behind a device at +90 degrees
    (6.123233995736766e-17, -1.0)
    """

    angle_rad: float
    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_rad: tuple[float, float] = (0.0, 0.0)

    def seen_from(self, azimuth_rad: float) -> tuple[float, float, float, float, float]:
        """Return turn, shift x, y and tilt x, y as a device at an azimuth sees them."""
        cosine, sine = np.cos(azimuth_rad), np.sin(azimuth_rad)
        (x, y), (u, v) = self.shift_mm, self.tilt_rad
        shift = float(cosine * x + sine * y), float(cosine * y - sine * x)
        tilt = float(cosine * u + sine * v), float(cosine * v - sine * u)
        return self.angle_rad - azimuth_rad, *shift, *tilt


@dataclass(frozen=True)
class VialPose:
    """The vial off the axis that the rig has it on.

    Parameters
    ----------
    shift_mm
        Lab x and y of its axis at z = 0.
    tilt_rad
        How far its axis leans towards lab x and y, small.
    """

    shift_mm: tuple[float, float] = (0.0, 0.0)
    tilt_rad: tuple[float, float] = (0.0, 0.0)

    def from_lab(self, point: FloatArray) -> FloatArray:
        """Return where a point (..., xyz) of the lab lies in the vial's frame."""
        return self.turned(point - np.array([*self.shift_mm, 0.0]))

    def turned(self, direction: FloatArray) -> FloatArray:
        """Return a direction (..., xyz) of the lab in the vial's frame, to first order in the tilt."""
        (u, v), (x, y, z) = self.tilt_rad, np.moveaxis(direction, -1, 0)
        return np.stack([x - u * z, y - v * z, z + u * x + v * y], axis=-1)
