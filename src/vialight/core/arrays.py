"""Every array layout, stated once.

========== ============================= =================================================================
name       axes                          meaning
========== ============================= =================================================================
frames     (frame, row, column)          camera counts; row 0 on top, column 0 leftmost
sinogram   (psi, x_v, z)                 counts along rays x cos(psi) - y sin(psi) = x_v at mid-height z
volume     (z, y, x)                     density, counts per mm; index grows with the coordinate
points     (point, xyz)                  mm, object frame
series     (t, z, y, x)                  volumes over time
========== ============================= =================================================================

Object frame: z is the rotation axis and points up; at stage angle 0, x points right in the camera's image and y away
from the camera.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

TURN_RAD = 2 * np.pi


@dataclass(frozen=True)
class Grid:
    """Cubic voxels about the rotation axis.

    Parameters
    ----------
    shape
        Voxel counts (z, y, x).
    voxel_mm
        Edge of a voxel.
    centre_z_mm
        Height of the grid's middle.

    Examples
    --------
    >>> Grid((2, 3, 3), 0.5).x_mm
    array([-0.5,  0. ,  0.5])
    """

    shape: tuple[int, int, int]
    voxel_mm: float
    centre_z_mm: float = 0.0

    @property
    def z_mm(self) -> FloatArray:
        """Heights of the voxel centres, ascending."""
        return self.centre_z_mm + centred(self.shape[0], self.voxel_mm)

    @property
    def y_mm(self) -> FloatArray:
        """Voxel centres along y, ascending."""
        return centred(self.shape[1], self.voxel_mm)

    @property
    def x_mm(self) -> FloatArray:
        """Voxel centres along x, ascending."""
        return centred(self.shape[2], self.voxel_mm)

    @property
    def origin_mm(self) -> tuple[float, float, float]:
        """Centre (z, y, x) of the voxel with index (0, 0, 0)."""
        return float(self.z_mm[0]), float(self.y_mm[0]), float(self.x_mm[0])


@dataclass(frozen=True)
class ParallelBeam:
    """The samples of a sinogram: rays ``x cos(psi) - y sin(psi) = x_v``.

    Parameters
    ----------
    psi_rad
        (psi,) even in number and evenly spaced over a full turn, so that the opposite of angle i is i + count/2.
    virtual_x_mm
        (x_v,) evenly spaced and symmetric about 0, so that the opposite of ray i is count - 1 - i.
    """

    psi_rad: FloatArray
    virtual_x_mm: FloatArray

    @property
    def spacing_mm(self) -> float:
        """Distance between neighbouring rays."""
        return float(self.virtual_x_mm[1] - self.virtual_x_mm[0])


@dataclass(frozen=True)
class Volume:
    """Scattering density on a grid.

    Parameters
    ----------
    density
        (z, y, x), counts per mm.
    grid
        Where its voxels lie.
    """

    density: Float32Array
    grid: Grid


def centred(count: int, spacing: float) -> FloatArray:
    """Return `count` coordinates of equal `spacing`, symmetric about 0."""
    return (np.arange(count, dtype=np.float64) - (count - 1) / 2) * spacing
