"""The reference as the page shows it: its sum projections on a snapshot's grid."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.columns import ColumnGrid, thickness
from vialight.core.mesh import Mesh


class ViewGrid(NamedTuple):
    """Where the pixels of sum projections lie: (z, y, x) voxels about the axis."""

    shape: tuple[int, int, int]
    voxel_mm: float
    centre_z_mm: float


class ReferenceSums(NamedTuple):
    """Mm of path through the reference: (y, x) along z, (z, x) along y, (z, y) along x."""

    xy: FloatArray
    xz: FloatArray
    yz: FloatArray


def reference_sums(mesh: Mesh, grid: ViewGrid) -> ReferenceSums:
    """Return how thick the reference is along z, y and x at the pixels of a snapshot.

    Parameters
    ----------
    mesh
        Closed, in the object frame.
    grid
        Of the snapshot.

    Examples
    --------
    >>> import trimesh
    >>> box = trimesh.creation.box((2, 4, 6))
    >>> sums = reference_sums(Mesh(box.vertices, box.faces), ViewGrid((62, 60, 60), 0.1, 0.0))
    >>> [round(float(image.max()), 9) for image in sums]
    [6.0, 4.0, 2.0]
    """
    z, y, x = grid.shape
    low_x, low_y = (-count * grid.voxel_mm / 2 for count in (x, y))
    low_z = grid.centre_z_mm - z * grid.voxel_mm / 2
    along_z = thickness(mesh, ColumnGrid(2, (low_x, low_y), grid.voxel_mm, (y, x)))
    along_y = thickness(mesh, ColumnGrid(1, (low_z, low_x), grid.voxel_mm, (x, z)))
    along_x = thickness(mesh, ColumnGrid(0, (low_y, low_z), grid.voxel_mm, (z, y)))
    return ReferenceSums(along_z, np.ascontiguousarray(along_y.T), along_x)
