"""A part as voxels: how much of each lies inside."""

from __future__ import annotations

import math

import numpy as np

from vialight.core.arrays import Float32Array, Grid
from vialight.core.columns import ColumnGrid, crossings
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target.placement import radius_about_axis

VOID_VOXELS = 4
"""Of resin on every side of the part.  Light is sent through the part only, so that beyond the circle round it all rays
have passed and the dose falls with the distance: what must not cure there is worst right beside the part, and a few
voxels, wider than blur and interpolation, see it."""
_MOST_VOXELS = 4_000_000_000
_FACES_AT_ONCE = 50_000
_SUBCOLUMNS = 4
"""Along x and y each.  Coverage is then off by 0.01 RMS at slanted faces, without bias, and level faces are exact; an
upright face along x or y is rounded to a quarter of a voxel, 16 um."""
_ONE = 1 << 16
"""A voxel's height in the whole numbers in which coverage is added, so that full is 1 and empty is 0 exactly."""


def target_grid(mesh: Mesh, voxel_mm: float, *, void_voxels: int = VOID_VOXELS) -> Grid:
    """Return the grid that holds a part and the resin next to it.

    Parameters
    ----------
    mesh
        The part as placed, object frame.
    voxel_mm
        Edge of the cubic voxels; the projector's pixel is the usual choice.
    void_voxels
        Voxels of resin beside, below and above the part, at least.

    Returns
    -------
    Grid
        In x and y centred on the axis, of an even count that holds the part at any angle of the stage; in z centred on
        the part.

    Raises
    ------
    InputError
        The voxel is no length, larger than a quarter of the part, or so small that no computer holds the grid.

    Examples
    --------
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> target_grid(corner, 0.1)
    Grid(shape=(48, 48, 48), voxel_mm=0.1, centre_z_mm=2.0)
    """
    size = float(mesh.extents_mm.max())
    if not (math.isfinite(voxel_mm) and 0 < voxel_mm <= size / 4):
        raise InputError(
            "--voxel", f"is {voxel_mm} mm for a part of {size:.4g} mm", accepted=f"more than 0, at most {size / 4:.4g}"
        )
    across = 2 * (_voxels_in(radius_about_axis(mesh), voxel_mm) + void_voxels)
    low, high = mesh.bounds_mm[:, 2]
    slices = _voxels_in(float(high - low), voxel_mm) + 2 * void_voxels
    if slices * across**2 > _MOST_VOXELS:
        raise InputError(
            "--voxel", f"{voxel_mm} mm makes {slices} x {across} x {across} voxels",
            accepted=f"at most {_MOST_VOXELS:.0e} of them", remedy="use larger voxels",
        )  # fmt: skip
    return Grid((slices, across, across), voxel_mm, float(low + high) / 2)


def voxelise(mesh: Mesh, grid: Grid, *, coverage: bool = False) -> Float32Array:
    """Measure how much of every voxel lies inside a part.

    Parameters
    ----------
    mesh
        Closed; what `check_sound` accepts.
    grid
        Where the voxels lie; what of the part lies outside is left out.
    coverage
        Whether to give shares, from 4 x 4 columns a voxel and exact lengths along z, in place of 1 where the voxel's
        centre is inside and 0 elsewhere.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, 0 to 1.

    Examples
    --------
    >>> block = Mesh([[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 0, 2]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> grid = Grid((8, 16, 16), 0.25, 1.0)
    >>> for shares in voxelise(block, grid), voxelise(block, grid, coverage=True):
    ...     print(f"{shares.sum() * grid.voxel_mm**3:.2f} of {block.volume_mm3:.2f} mm^3")
    1.31 of 1.33 mm^3
    1.33 of 1.33 mm^3
    """
    slices, rows, columns = grid.shape
    across = _SUBCOLUMNS if coverage else 1
    edge_z, edge_y, edge_x = (centre - grid.voxel_mm / 2 for centre in grid.origin_mm)
    fine = ColumnGrid(2, (edge_x, edge_y), grid.voxel_mm / across, (rows * across, columns * across))
    # What begins and ends in each voxel, counted up from the bottom afterwards; one slice more takes what ends on top.
    steps = np.zeros((slices + 2, rows * columns), dtype=np.int32 if coverage else np.int8)
    for start in range(0, len(mesh.faces), _FACES_AT_ONCE):
        found = crossings(Mesh(mesh.vertices_mm, mesh.faces[start : start + _FACES_AT_ONCE]), fine)
        v, u = np.divmod(found.column, columns * across)
        column = v // across * columns + u // across
        height = np.clip((found.height_mm - edge_z) / grid.voxel_mm, 0, slices)
        if coverage:
            first = height.astype(np.int64)
            above = np.rint((height - first) * _ONE).astype(np.int32)
            sense = -found.outward.astype(np.int32)
            np.add.at(steps, (first, column), sense * (_ONE - above))
            np.add.at(steps, (first + 1, column), sense * above)
        else:
            np.add.at(steps, (np.ceil(height - 0.5).astype(np.int64), column), -found.outward.astype(np.int8))
    inside = np.cumsum(steps[:slices], axis=0, dtype=steps.dtype, out=steps[:slices])
    full = _ONE * across**2 if coverage else 1
    shares: Float32Array = inside.astype(np.float32)
    shares /= full
    return np.clip(shares, 0, 1, out=shares).reshape(grid.shape)


def _voxels_in(length_mm: float, voxel_mm: float) -> int:
    return math.ceil(length_mm / voxel_mm - 1e-6)
