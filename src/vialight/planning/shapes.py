"""Parts made by formula, for tests, examples and benchmarks: watertight, and the same on every machine.

They are centred on the origin, and fit a vial of some 8 mm of field.  Those with curved faces are contours of an
implicit function on a grid; faces of the box are exact.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray, Grid, Volume
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology.surface import isosurface

_FOOT_POINT_STEPS = 6
"""Each gains a factor of about distance times curvature, which is under 0.2 in a wall."""
_THICKEST_WALL = 0.25
"""Of the cell: beyond it the two sides of a gyroid's wall meet those of the next."""


def gyroid(
    diameter_mm: float = 14.0,
    height_mm: float = 10.0,
    cell_mm: float = 7.0,
    wall_mm: float = 1.0,
    *,
    pitch_mm: float = 0.1,
) -> Mesh:
    """Return a sheet gyroid cut out of an upright cylinder.

    Parameters
    ----------
    diameter_mm, height_mm
        Of the cylinder.
    cell_mm
        Period of the gyroid along x, y and z.
    wall_mm
        True thickness of the sheet, at right angles to it and the same everywhere.
    pitch_mm
        Of the grid that it is contoured on: edges are blunt by less than this, faces true to about 1 um.

    Raises
    ------
    InputError
        A length is not positive, or the wall is too thick for the cell or too thin for the grid.

    Notes
    -----
    The middle of the sheet is ``sin(kx) cos(ky) + sin(ky) cos(kz) + sin(kz) cos(kx) = 0`` with ``k = 2 pi / cell``
    (Schoen 1970).  Common generators cut at constant values of that function, which makes walls that are a quarter
    thicker in some places than in others; here the distance from the middle is computed by foot points.

    Examples
    --------
    >>> part = gyroid(6, 4, 4, 0.8, pitch_mm=0.2)
    >>> part.is_closed, part.extents_mm.round(1).tolist()
    (True, [6.0, 6.0, 4.0])
    """
    _check_positive(diameter_mm=diameter_mm, height_mm=height_mm, cell_mm=cell_mm, wall_mm=wall_mm, pitch_mm=pitch_mm)
    if not 2 * pitch_mm <= wall_mm <= _THICKEST_WALL * cell_mm:
        raise InputError(
            "wall_mm", f"is {wall_mm:g} for a cell of {cell_mm:g} mm and a pitch of {pitch_mm:g} mm",
            accepted=f"{2 * pitch_mm:g} to {_THICKEST_WALL * cell_mm:g}",
        )  # fmt: skip
    grid = _grid_round((diameter_mm, diameter_mm, height_mm), pitch_mm)
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij", sparse=True)
    depth = np.minimum(diameter_mm / 2 - np.hypot(x, y), height_mm / 2 - np.abs(z))
    near = np.flatnonzero(depth > -2 * pitch_mm)
    points = np.stack([np.broadcast_to(axis, grid.shape).ravel()[near] for axis in (x, y, z)], axis=1)
    within_wall = wall_mm / 2 - _distance_from_gyroid(points, cell_mm, wall_mm / 2 + 2 * pitch_mm)
    depth.ravel()[near] = np.minimum(depth.ravel()[near], within_wall)
    return _contour(depth, grid)


def bracket(*, pitch_mm: float = 0.1) -> Mesh:
    """Return an angle bracket of 12 x 8 x 10 mm: 2 mm plates, a rib, two holes of 2.4 mm and two of 1.6 mm.

    Parameters
    ----------
    pitch_mm
        Of the grid that it is contoured on: edges are blunt by less than this.

    Raises
    ------
    InputError
        The pitch is not positive, or too coarse for the plates.

    Examples
    --------
    >>> part = bracket(pitch_mm=0.2)
    >>> part.is_closed, part.extents_mm.round(1).tolist()
    (True, [12.0, 8.0, 10.0])
    """
    _check_positive(pitch_mm=pitch_mm)
    if pitch_mm > 0.5:
        raise InputError("pitch_mm", f"is {pitch_mm:g}", accepted="up to 0.5, a quarter of the plates")
    grid = _grid_round((12.0, 8.0, 10.0), pitch_mm)
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij", sparse=True)
    width = 4.0 - np.abs(y)
    floor = np.minimum(6.0 - np.abs(x), 1.0 - np.abs(z + 4.0))
    back = np.minimum(1.0 - np.abs(x + 5.0), 5.0 - np.abs(z))
    slope = (-1.0 - x - z) / math.sqrt(2)  # from the floor at x = 2 to the back at z = 3
    rib = np.minimum(np.minimum(0.8 - np.abs(y), slope), np.minimum(x + 5.0, z + 4.0))
    solid = np.maximum(np.minimum(np.maximum(floor, back), width), rib)
    floor_holes = np.hypot(x - 3.6, np.abs(y) - 2.2) - 1.2
    back_holes = np.hypot(np.abs(y) - 2.4, z - 1.6) - 0.8
    return _contour(np.minimum(solid, np.minimum(floor_holes, back_holes)), grid)


def thin_wall_box(sides_mm: tuple[float, float, float] = (10.0, 8.0, 9.0), wall_mm: float = 0.4) -> Mesh:
    """Return a box without a lid; its faces are exact.

    Parameters
    ----------
    sides_mm
        Outer lengths along x, y and z.
    wall_mm
        Thickness of the sides and of the floor.

    Raises
    ------
    InputError
        A length is not positive, or the wall leaves no inside.

    Examples
    --------
    >>> part = thin_wall_box((10, 8, 9), 0.5)
    >>> part.is_closed, round(part.volume_mm3, 6), 10 * 8 * 9 - 9 * 7 * 8.5
    (True, 184.5, 184.5)
    """
    _check_positive(wall_mm=wall_mm, **{f"sides_mm[{k}]": side for k, side in enumerate(sides_mm)})
    limit = min(sides_mm[0] / 2, sides_mm[1] / 2, sides_mm[2])
    if wall_mm >= limit:
        raise InputError("wall_mm", f"is {wall_mm:g}", accepted=f"less than {limit:g}, so that there is an inside")
    half_x, half_y, half_z = (side / 2 for side in sides_mm)
    corners = [
        (sign_x * (half_x - inset), sign_y * (half_y - inset), z)
        for inset, z in ((0.0, -half_z), (0.0, half_z), (wall_mm, half_z), (wall_mm, wall_mm - half_z))
        for sign_x, sign_y in ((-1, -1), (1, -1), (1, 1), (-1, 1))
    ]
    # Rings of four corners, from the floor's outside up, over the rim, and down to the floor's inside.
    quads = [(3, 2, 1, 0), (12, 13, 14, 15)]
    quads += [(low, low - low % 4 + (low + 1) % 4, low - low % 4 + (low + 1) % 4 + 4, low + 4) for low in range(12)]
    return Mesh(np.array(corners), np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))]))


def _grid_round(sides_mm: tuple[float, float, float], pitch_mm: float) -> Grid:
    """Return a grid with two samples outside; its counts are even, so that no sample is at a multiple of the pitch."""
    across_x, across_y, across_z = (2 * (math.ceil(side / 2 / pitch_mm - 1e-6) + 2) for side in sides_mm)
    return Grid((across_z, across_y, across_x), pitch_mm)


def _contour(depth_mm: FloatArray, grid: Grid) -> Mesh:
    """Return the surface where a depth inside the part is 0, without the crumbs that a cut leaves at sharp edges."""
    return isosurface(Volume(depth_mm.astype(np.float32), grid), 0.0, smallest_piece_mm3=grid.voxel_mm**3)


def _distance_from_gyroid(points: FloatArray, cell_mm: float, farthest_mm: float) -> FloatArray:
    """Return how far (n, 3) points are from the middle of the sheet; beyond `farthest_mm` only that they are farther.

    The foot point q of p is on the sheet, and p - q is at right angles to it: from a first guess, each step goes to the
    sheet along its normal, and along the sheet to where p is straight above.
    """
    wave_number = 2 * np.pi / cell_mm
    value, slope = _gyroid(points * wave_number)
    # In units of 1/k the function's slope is at most sqrt(3), and this estimate of the distance too small by little.
    distance = np.abs(value) / np.maximum(np.linalg.norm(slope, axis=1), 1e-3) / wave_number
    close = np.flatnonzero(np.abs(value) / wave_number < math.sqrt(3) * farthest_mm)
    start = points[close] * wave_number
    foot = start.copy()
    for _ in range(_FOOT_POINT_STEPS):
        value, slope = _gyroid(foot)
        steepness = np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-3)
        normal = slope / steepness
        above = start - foot
        foot += above - normal * (above * normal).sum(axis=1, keepdims=True) - normal * value[:, None] / steepness
    distance[close] = np.linalg.norm(start - foot, axis=1) / wave_number
    return np.asarray(distance)


def _gyroid(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the gyroid's function and its gradient at (n, 3) points, in units of cell / 2 pi."""
    sine, cosine = np.sin(points), np.cos(points)
    following: NDArray[np.float64] = np.roll(cosine, -1, axis=1)
    value = (sine * following).sum(axis=1)
    gradient = cosine * following - sine * np.roll(sine, 1, axis=1)
    return value, gradient


def _check_positive(**lengths_mm: float) -> None:
    for name, length in lengths_mm.items():
        if not (math.isfinite(length) and length > 0):
            raise InputError(name, f"is {length}", accepted="a positive length in mm")
