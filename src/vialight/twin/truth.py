"""What was really printed: the gelled surface, and what a profilometer would make of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from vialight.core.arrays import Float32Array, Grid
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology.contours import above_ties, contour


def gelled_surface(conversion: Float32Array, grid: Grid, gel_conversion: float, *, shrinkage: float = 0.0) -> Mesh:
    """Draw the surface on which the conversion is that of the gel point.

    Parameters
    ----------
    conversion
        (y, x, z) float32.
    grid
        Where its voxels lie.
    gel_conversion
        The gel point.
    shrinkage
        By which share all lengths have shrunk, about the grid's middle.

    Returns
    -------
    Mesh
        Closed, object frame, faces outward; what reaches the grid's end is closed half a voxel or less beyond it.

    Raises
    ------
    InputError
        Nothing has gelled.

    Examples
    --------
    >>> grid = Grid((41, 41, 41), 0.1)
    >>> r2 = grid.x_mm**2 + grid.y_mm[:, None] ** 2
    >>> ball = (1.5 - np.sqrt(r2[..., None] + grid.z_mm**2)).astype(np.float32)
    >>> gelled_surface(ball, grid, 0.5).extents_mm.round(2)
    array([2., 2., 2.])
    """
    if not float(conversion.max()) > gel_conversion:
        raise InputError(
            "twin", f"nothing has gelled: conversion is at most {conversion.max():.4g}",
            accepted=f"more than {gel_conversion:g}", remedy="print longer",
        )  # fmt: skip
    # Below the level all round, so that the surface closes.
    padded = np.pad(conversion.transpose(2, 0, 1), 1)
    z, y, x = (origin - grid.voxel_mm for origin in grid.origin_mm)
    surface = contour(padded, (z, y, x), grid.voxel_mm, above_ties(gel_conversion))
    middle = np.array([0.0, 0.0, grid.centre_z_mm])
    return Mesh((surface.vertices_mm - middle) * (1 - shrinkage) + middle, surface.faces)


def gel_times(
    before: Float32Array, after: Float32Array, start_s: float, duration_s: float, gel_conversion: float,
    known: Float32Array,
) -> Float32Array:  # fmt: skip
    """Return when each voxel gelled: `known` where it had, now where it has since, by interpolation in conversion.

    Examples
    --------
    >>> before, after = np.array([0.0, 0.1], np.float32), np.array([0.1, 0.3], np.float32)
    >>> gel_times(before, after, 10.0, 2.0, 0.2, np.full(2, np.nan, np.float32))
    array([nan, 11.], dtype=float32)
    """
    now = np.isnan(known) & (after >= gel_conversion)
    times = known.copy()
    rise = np.maximum(after[now] - before[now], np.float32(1e-9))
    times[now] = start_s + duration_s * np.clip((gel_conversion - before[now]) / rise, 0, 1)
    return times


def height_map(
    conversion: Float32Array, grid: Grid, gel_conversion: float, *, pixel_mm: float = 0.05,
    set_down_at_mm: tuple[float, float] = (0.0, 0.0),
) -> NDArray[np.float64]:  # fmt: skip
    """Return what a profilometer measures of the washed part: heights of its upper side over its lowest point.

    Parameters
    ----------
    conversion, grid, gel_conversion
        As for `gelled_surface`.
    pixel_mm
        Of the map.
    set_down_at_mm
        x and y of the axis in the map, from its middle: parts are rarely set down in the middle.

    Returns
    -------
    numpy.ndarray
        (row, column) mm, y downwards; NaN where there is no part.
    """
    solid = conversion >= gel_conversion
    if not solid.any():
        raise InputError("twin", "nothing has gelled", accepted="a part", remedy="print longer")
    depth = solid.shape[2]
    top = depth - 1 - np.argmax(solid[..., ::-1], axis=2)
    rows, columns = np.indices(top.shape)
    here = conversion[rows, columns, top]
    over = conversion[rows, columns, np.minimum(top + 1, depth - 1)]
    share = np.clip((here - gel_conversion) / np.maximum(here - over, np.float32(1e-9)), 0, 1)
    floor = np.flatnonzero(solid.any(axis=(0, 1)))[0]
    height = np.where(solid.any(axis=2), (top + share - floor + 0.5) * grid.voxel_mm, np.nan)
    rows_out, columns_out = (int(count * grid.voxel_mm / pixel_mm) for count in height.shape)
    y = -((np.arange(rows_out) - (rows_out - 1) / 2) * pixel_mm) - set_down_at_mm[1]
    x = (np.arange(columns_out) - (columns_out - 1) / 2) * pixel_mm - set_down_at_mm[0]
    at = np.meshgrid((y - grid.y_mm[0]) / grid.voxel_mm, (x - grid.x_mm[0]) / grid.voxel_mm, indexing="ij")
    edge = map_coordinates(conversion.max(axis=2), at, order=1, cval=0.0)
    filled = np.where(np.isnan(height), np.nanmedian(height), height)
    return np.where(edge >= gel_conversion, map_coordinates(filled, at, order=1, mode="nearest"), np.nan)
