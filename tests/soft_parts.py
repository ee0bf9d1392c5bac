"""Parts given by formula, as densities that the twin's camera can look at."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from scipy.special import expit

from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Rig
from vialight.twin.camera import frames_of, imager_for
from vialight.twin.poses import Pose

CURED = 200.0
"""Counts per mm of a cured interior, as in the shared cases."""

EDGE_MM = 0.2
"""Width of the soft edge of a part, as in the shared cases."""

Field = Callable[[Any, Any, Any], Any]
"""A scalar of (x, y, z) in the object frame, mm; arrays in, arrays of the same shape and type out."""


def softened(signed_distance_mm: Any) -> Any:
    """Return the density of a cured part: half of `CURED` on its surface, soft over `EDGE_MM`."""
    return CURED * expit(-4 / EDGE_MM * signed_distance_mm)


def soft_density(signed_distance: Field, grid: Grid) -> Float32Array:
    """Return a part's density (y, x, z) at voxel centres."""
    x, z = (axis.astype(np.float32) for axis in (grid.x_mm[:, None], grid.z_mm))
    density = np.empty((grid.shape[1], grid.shape[2], grid.shape[0]), np.float32)
    for layer, y in zip(density, grid.y_mm.astype(np.float32), strict=True):
        layer[:] = softened(signed_distance(x, y, z))
    return density


def frames_of_part(
    signed_distance: Field, grid: Grid, rig: Rig, shape: tuple[int, int], angles_rad: FloatArray
) -> Float32Array:
    """Return what a rig's camera would count of a part, (frame, row, column), without noise.

    Voxels of 0.05 mm, a quarter of the soft edge, are fine enough: where the density ends softly, what linear
    interpolation adds on one side of the surface it takes on the other.
    """
    density = soft_density(signed_distance, grid)
    return frames_of(density, grid, imager_for(rig, shape), [Pose(float(angle)) for angle in angles_rad])
