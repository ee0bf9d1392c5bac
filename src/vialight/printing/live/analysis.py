"""What about once a second is measured on the live volume: surface, deviation, overlap, gel times."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from scipy.ndimage import map_coordinates

from vialight.core.arrays import BoolArray, Float32Array, FloatArray, Grid, Volume
from vialight.core.compiling import FAST_MATH
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.messages import Sums
from vialight.metrology import sample_surface, signed_distance
from vialight.metrology.distance import SurfaceTree
from vialight.metrology.surface import isosurface
from vialight.planning.target import voxelise

MARGIN_MM = 1.0
"""Of resin about the reference that is looked at each second."""
_FIELD_PITCH = 2
"""Of the distance field, in voxels: between its points distances are interpolated."""
_REVERSE_SAMPLES = 5000
_MOST_VOXELS, _MOST_VERTICES = 16_000_000, 1_000_000
"""Of what is measured once a second, beside the process that renews the volume with every frame."""


def region_of(grid: Grid, reference: Mesh | None) -> tuple[slice, slice, slice]:
    """Return the (z, y, x) part of a volume that holds the reference, evenly about the axis; all of it without one."""
    if reference is None:
        return slice(0, grid.shape[0]), slice(0, grid.shape[1]), slice(0, grid.shape[2])
    low, high = reference.bounds_mm
    z = (np.array([low[2] - MARGIN_MM, high[2] + MARGIN_MM]) - grid.z_mm[0]) / grid.voxel_mm
    first, last = max(0, int(np.floor(z[0]))), min(grid.shape[0], int(np.ceil(z[1])) + 1)
    across = []
    for axis, count in ((1, grid.shape[1]), (0, grid.shape[2])):
        reach = max(abs(low[axis]), abs(high[axis])) + MARGIN_MM
        skipped = max(0, count // 2 - int(np.ceil(reach / grid.voxel_mm)) - 1)
        across.append(slice(skipped, count - skipped))
    return slice(first, max(last, first + 2)), across[0], across[1]


def grid_of(grid: Grid, region: tuple[slice, slice, slice]) -> Grid:
    """Return the grid of a region that `region_of` gave."""
    z, y, x = region
    heights = grid.z_mm[z]
    shape = (z.stop - z.start, y.stop - y.start, x.stop - x.start)
    return Grid(shape, grid.voxel_mm, float(heights[0] + heights[-1]) / 2)


@dataclass(frozen=True)
class Yardstick:
    """A reference, made ready to be compared with once a second.

    Parameters
    ----------
    reference
        The mesh that is meant.
    field_mm
        (z, y, x) signed distances to it at every second voxel of the region.
    inside
        (z, y, x) voxels of the region that lie inside it.
    samples_mm
        (point, xyz) on its surface.
    """

    reference: Mesh
    field_mm: Float32Array
    inside: BoolArray
    samples_mm: FloatArray


def yardstick(reference: Mesh, grid: Grid) -> Yardstick:
    """Prepare a reference for a region's grid."""
    axes = [axis[::_FIELD_PITCH] for axis in (grid.z_mm, grid.y_mm, grid.x_mm)]
    z, y, x = np.meshgrid(*axes, indexing="ij")
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    field = signed_distance(points, reference).reshape(z.shape).astype(np.float32)
    samples = sample_surface(reference, _REVERSE_SAMPLES).points_mm[-_REVERSE_SAMPLES:]
    return Yardstick(reference, field, voxelise(reference, grid) > 0.5, samples)


@dataclass(frozen=True)
class Measured:
    """What was found; numbers are None where there is no surface or no reference."""

    surface: Mesh | None
    deviation_mm: Float32Array
    rmse_mm: float | None
    reverse_rmse_mm: float | None
    iou: float | None


def measure(volume: Volume, threshold: float, against: Yardstick | None) -> Measured:
    """Draw the surface of a volume and compare it.

    Deviations are read off the distance field, which is good to some hundredths of a voxel on faces and to a tenth at
    edges: for the eye and for curves; the finished print is measured exactly.  A surface of too many vertices, such as
    noise at the threshold makes, is drawn anew on coarser voxels.
    """
    try:
        surface = isosurface(volume, threshold)
        drawn = volume
        while len(surface.vertices_mm) > _MOST_VERTICES:
            drawn = coarser(drawn)
            surface = isosurface(drawn, threshold)
    except InputError:
        return Measured(None, np.empty(0, np.float32), None, None, None)
    if against is None:
        return Measured(surface, np.empty(0, np.float32), None, None, None)
    grid = volume.grid
    at = (surface.vertices_mm[:, ::-1] - np.array(grid.origin_mm)) / (grid.voxel_mm * _FIELD_PITCH)
    deviation = map_coordinates(against.field_mm, at.T, order=1, mode="nearest")
    weights = np.zeros(len(surface.vertices_mm))
    np.add.at(weights, surface.faces.ravel(), np.repeat(surface.face_areas_mm2 / 3, 3))
    back = SurfaceTree(surface).nearest(against.samples_mm).distance_mm
    cured = volume.density >= threshold
    return Measured(
        surface, deviation,
        float(np.sqrt(np.average(deviation**2, weights=weights))),
        float(np.sqrt(np.mean(back**2))),
        float((cured & against.inside).sum() / (cured | against.inside).sum()),
    )  # fmt: skip


def measured_grid(grid: Grid) -> Grid:
    """Return the voxels on which a region is measured: its own, or coarser ones where it has too many.

    Examples
    --------
    >>> measured_grid(Grid((300, 481, 481), 0.05))
    Grid(shape=(150, 241, 241), voxel_mm=0.1, centre_z_mm=0.0)
    """
    while np.prod(grid.shape) > _MOST_VOXELS:
        grid = _coarser_grid(grid)
    return grid


def coarsened(volume: Volume, grid: Grid) -> Volume:
    """Return a copy of a volume on the voxels that `measured_grid` gave."""
    if volume.grid.shape == grid.shape:
        return Volume(volume.density.copy(order="K"), grid)
    while volume.grid.shape != grid.shape:
        volume = coarser(volume)
    return volume


def _coarser_grid(grid: Grid) -> Grid:
    z, y, x = (-(-count // 2) for count in grid.shape)
    return Grid((z, y, x), 2 * grid.voxel_mm, grid.centre_z_mm)


def coarser(volume: Volume) -> Volume:
    """Return a volume on voxels twice as wide about the same centre.

    Examples
    --------
    >>> coarser(Volume(np.arange(24, dtype=np.float32).reshape(2, 3, 4), Grid((2, 3, 4), 0.1))).density
    array([[[ 6.5,  8.5],
            [14.5, 16.5]]], dtype=float32)
    """
    grid = _coarser_grid(volume.grid)
    z, y, x = grid.shape
    density = np.empty((y, x, z), np.float32)
    _halve(volume.density.transpose(1, 2, 0), density)
    return Volume(density.transpose(2, 0, 1), grid)


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def _halve(fine: Float32Array, coarse: Float32Array) -> None:
    # Of an odd count every second voxel lies evenly about the centre; of an even one, the middles of pairs.
    step_y, step_x, step_z = 1 - fine.shape[0] % 2, 1 - fine.shape[1] % 2, 1 - fine.shape[2] % 2
    rows, columns, depth = coarse.shape
    eighth = np.float32(0.125)
    for y in range(rows):
        for x in range(columns):
            a, b = fine[2 * y, 2 * x], fine[2 * y, 2 * x + step_x]
            c, d = fine[2 * y + step_y, 2 * x], fine[2 * y + step_y, 2 * x + step_x]
            for z in range(depth):
                low, high = 2 * z, 2 * z + step_z
                coarse[y, x, z] = eighth * (a[low] + b[low] + c[low] + d[low] + a[high] + b[high] + c[high] + d[high])


def middle_slices(density: Float32Array) -> Sums:
    """Return the middle planes of a (z, y, x) volume."""
    z, y, x = (count // 2 for count in density.shape)
    return Sums(density[z].copy(), density[:, y].copy(), density[:, :, x].copy())


class GelTimeMap:
    """When each voxel gelled, and the mean of that along each axis.

    Parameters
    ----------
    shape
        (z, y, x) of the region.

    Examples
    --------
    >>> times = GelTimeMap((1, 1, 2))
    >>> times.note(np.array([[[5, 0]]], np.float32), 4.0, 10.0)
    >>> times.note(np.array([[[6, 5]]], np.float32), 4.0, 12.0)
    >>> times.lit_s, times.means().xz
    (array([[[10., 12.]]], dtype=float32), array([[10., 12.]], dtype=float32))
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        z, y, x = shape
        self._lit_s = np.full((y, x, z), np.nan, np.float32)
        self._sums, self._counts = (
            (np.zeros((y, x)), np.zeros((x, z)), np.zeros((y, z))) for _ in range(2)
        )  # along z, y, x

    @property
    def lit_s(self) -> Float32Array:
        """(z, y, x) light that a voxel had had when it was first seen above the threshold, s; NaN where it was not."""
        return self._lit_s.transpose(2, 0, 1)

    def note(self, density: Float32Array, threshold: float, lit_s: float) -> None:
        """Look at a (z, y, x) density."""
        _note(self._lit_s, density.transpose(1, 2, 0), threshold, np.float32(lit_s), self._sums, self._counts)

    def means(self) -> Sums:
        """Return the mean along each axis; NaN where nothing has gelled."""
        with np.errstate(invalid="ignore"):
            xy, xz, yz = ((s / n).astype(np.float32) for s, n in zip(self._sums, self._counts, strict=True))
        return Sums(xy, xz.T, yz.T)


@njit(nogil=True, cache=True)
def _note(
    times: Float32Array,
    density: Float32Array,
    threshold: float,
    lit_s: np.float32,
    sums: tuple[FloatArray, FloatArray, FloatArray],
    counts: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    rows, columns, depth = times.shape
    for y in range(rows):
        for x in range(columns):
            for z in range(depth):
                if density[y, x, z] >= threshold and np.isnan(times[y, x, z]):
                    times[y, x, z] = lit_s
                    sums[0][y, x] += lit_s
                    sums[1][x, z] += lit_s
                    sums[2][y, z] += lit_s
                    counts[0][y, x] += 1
                    counts[1][x, z] += 1
                    counts[2][y, z] += 1
