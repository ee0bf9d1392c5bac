"""All that bends rays, in one vector: outer radius, index, distance, wall, the wall's index, a pixel's size."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from vialight.calibration.edges import edge_x_c_mm
from vialight.core.arrays import FloatArray
from vialight.core.config import Optics
from vialight.optics.refraction import camera_to_virtual

RADIUS, INDEX, DISTANCE, WALL, WALL_INDEX, PIXEL = range(6)
"""Places in the vector; lengths in mm."""


def bending(optics: Optics, pixel_mm: float) -> FloatArray:
    """Return the vector (6,) of a device.

    Examples
    --------
    >>> bending(Optics(12.4, 11.3, 1.472, 1.48, 190.0), 0.155).round(3).tolist()
    [12.4, 1.48, 190.0, 1.1, 1.472, 0.155]
    """
    wall = optics.outer_radius_mm - optics.inner_radius_mm
    return np.array([optics.outer_radius_mm, optics.resin_index, optics.distance_mm, wall, optics.wall_index, pixel_mm])


def optics_of(vector: FloatArray) -> Optics:
    """Return a device from its vector."""
    radius, index, distance, wall, wall_index = (float(value) for value in vector[:PIXEL])
    return Optics(radius, radius - wall, wall_index, index, distance)


def usual_widths(vector: FloatArray) -> FloatArray:
    """Return what standard uncertainties (6,) a rig's values are taken to have where it does not state them.

    Radius 0.2 mm, index 0.01, distance a tenth, wall 0.05 mm, its index 0.005, a pixel 0.2 %.
    """
    return np.array([0.2, 0.01, 0.1 * vector[DISTANCE], 0.05, 0.005, 0.002 * vector[PIXEL]])


def bend_rad(vector: FloatArray, columns: FloatArray, z_c_mm: FloatArray) -> FloatArray:
    """Return gamma (x, z) of rays so many columns beside the axis."""
    return camera_to_virtual(columns[:, None] * vector[PIXEL], z_c_mm, optics_of(vector)).direction_rad


def vial_columns(vector: FloatArray) -> float:
    """Return how many columns the vial's edges are seen apart."""
    return 2 * edge_x_c_mm(optics_of(vector)) / float(vector[PIXEL])


def by_width(value: Callable[[FloatArray], Any], vector: FloatArray, widths: FloatArray) -> FloatArray:
    """Return by how much a value (...) changes for a width of each of the vector's, (6, ...), to first order."""
    steps = 1e-2 * np.diag(widths)
    return np.array([(value(vector + step) - value(vector - step)) / 2e-2 for step in steps])
