"""Where in a device's image, and in which direction, a ray of the resin is seen; cameras and projectors alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.optics.refraction import camera_to_virtual, height_to_camera, transmission, virtual_to_camera

EDGE_MARGIN = 0.9995
"""Share of the field that is read: at its very edge rays graze the glass and columns have no width."""


def vial_edge_columns(camera: Camera, optics: Optics) -> tuple[float, float]:
    """Return the columns of the outermost rays that reach the resin: the vial's edges in the image."""
    edge_mm, _ = virtual_to_camera(EDGE_MARGIN * optics.field_radius_mm, 0.0, optics)
    edge = float(edge_mm) / camera.pixel_mm
    return camera.axis_column - edge, camera.axis_column + edge


def heights_seen(rows: int, camera: Camera, optics: Optics | None) -> tuple[float, float]:
    """Return the lowest and highest z, in mm, that every column of the field sees."""
    bottom, top = (np.array([(camera.optical_row - row) * camera.pixel_mm]) for row in (rows - 1, 0))
    if optics is None:
        return float(bottom[0]), float(top[0])
    x_c = EDGE_MARGIN * optics.outer_radius_mm * np.linspace(0, 1, 33)
    lowest = np.nanmax(camera_to_virtual(x_c, bottom, optics).mid_height_mm)
    highest = np.nanmin(camera_to_virtual(x_c, top, optics).mid_height_mm)
    return float(lowest), float(highest)


def ray_tilt(virtual_x_mm: FloatArray, optics: Optics) -> FloatArray:
    """Return the climb of rays in the resin, per mm of their plan view and per mm of their mid-height.

    It is evaluated at a height of half the field's radius and changes with height by less than 0.3 % up to D/13, which
    is 1 um at the ends of a tall print.

    Parameters
    ----------
    virtual_x_mm
        (x_v,); beyond the field the value at its edge.
    optics
        The device and the vial.
    """
    edge = EDGE_MARGIN * optics.field_radius_mm
    height = optics.field_radius_mm / 2
    inside = np.clip(virtual_x_mm, -edge, edge)
    return camera_to_virtual(*virtual_to_camera(inside, height, optics), optics).slope / height


def pixels_of(
    virtual_x_mm: FloatArray, mid_height_mm: FloatArray, camera: Camera, optics: Optics | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fractional column and row in which rays are seen, and their direction gamma; NaN where none is.

    Parameters
    ----------
    virtual_x_mm, mid_height_mm
        Of the rays; any shapes that broadcast.
    camera, optics
        As the rig has them; no optics for rays without a vial.
    """
    if optics is None:
        x_c, z_c = np.broadcast_arrays(virtual_x_mm, mid_height_mm)
        direction = np.zeros(x_c.shape)
    else:
        x_c, z_c = virtual_to_camera(virtual_x_mm, mid_height_mm, optics)
        direction = camera_to_virtual(x_c, z_c, optics).direction_rad
    return x_c / camera.pixel_mm + camera.axis_column, camera.optical_row - z_c / camera.pixel_mm, direction


def columns_and_directions(
    virtual_x: FloatArray, z_mid: float, camera: Camera, optics: Optics | None
) -> tuple[FloatArray, FloatArray]:
    """Return the fractional column and gamma of each ray at one mid-height; NaN outside the field."""
    if optics is not None:
        virtual_x = np.where(np.abs(virtual_x) <= EDGE_MARGIN * optics.field_radius_mm, virtual_x, np.nan)
    column, _, direction = pixels_of(virtual_x, np.asarray(z_mid), camera, optics)
    return column, direction


def rows_of(x_c: FloatArray, z_mm: FloatArray, camera: Camera, optics: Optics | None) -> FloatArray:
    """Return, as (column, z), the fractional rows in which columns see mid-heights."""
    z_c = (
        np.broadcast_to(z_mm, (len(x_c), len(z_mm))) if optics is None else height_to_camera(x_c[:, None], z_mm, optics)
    )
    return camera.optical_row - z_c / camera.pixel_mm


def rows_and_plan_share(
    columns: int, z_mm: FloatArray, camera: Camera, optics: Optics | None
) -> tuple[FloatArray, FloatArray]:
    """Return, as (column, z), the fractional row that sees a height and the cosine of its ray's climb in the resin."""
    x_c: FloatArray = (np.arange(columns, dtype=np.float64) - camera.axis_column) * camera.pixel_mm
    if optics is None:
        row = rows_of(x_c, z_mm, camera, None)
        return row, np.ones_like(row)
    # Columns beside the vial only lend a neighbour to the cubic of the last one that sees it.
    edge, _ = virtual_to_camera(EDGE_MARGIN * optics.field_radius_mm, 0.0, optics)
    x_c = np.clip(x_c, -edge, edge)
    # Both are smooth in z: through three heights of a thin stack, parabolas are exact to 1e-5 rows.
    knots = np.array([z_mm[0], (z_mm[0] + z_mm[-1]) / 2, z_mm[-1]])
    row_at = rows_of(x_c, knots, camera, optics)
    slope_at = camera_to_virtual(x_c[:, None], (camera.optical_row - row_at) * camera.pixel_mm, optics).slope
    u = (z_mm - knots[1]) / max(knots[2] - knots[1], 1e-12)
    weights = np.stack([u * (u - 1) / 2, 1 - u**2, u * (u + 1) / 2])
    slope = slope_at @ weights
    return row_at @ weights, 1 / np.sqrt(1 + slope**2)


class PixelRays(NamedTuple):
    """The rays of all pixels of an image, (row, column); NaN, and delivery 0, where they miss the resin."""

    virtual_x_mm: FloatArray
    direction_rad: FloatArray
    mid_height_mm: FloatArray
    width_mm: FloatArray
    """Of what the pixel lights in the resin, across its ray seen from above."""
    height_mm: FloatArray
    """Of the same, in mid-heights."""
    delivery: FloatArray
    """Light per area in the resin, closest to the axis, per light per area in air in the plane of the axis."""


def pixels_in_reach(
    columns: int, rows: int, camera: Camera, optics: Optics | None, radius_mm: float, low_mm: float, high_mm: float
) -> tuple[slice, slice]:
    """Return rows and columns of an image that hold all rays within a radius and between two mid-heights."""
    edge = radius_mm if optics is None else min(radius_mm, EDGE_MARGIN * optics.field_radius_mm)
    # Seen height changes from the axis to the edge all one way.
    column, row, _ = pixels_of(np.array([-edge, 0.0, edge]), np.array([[low_mm], [high_mm]]), camera, optics)
    return _span(row, rows), _span(column, columns)


def _span(places: FloatArray, count: int) -> slice:
    """Return the pixels of `count` that hold all places and one more to either side; all where a place has no ray."""
    if not np.isfinite(places).all():
        return slice(0, count)
    first, stop = int(np.floor(places.min())) - 1, int(np.ceil(places.max())) + 2
    return slice(min(max(first, 0), count), max(min(stop, count), 0))


def pixel_rays(
    columns: int, rows: int, camera: Camera, optics: Optics | None, absorption_per_mm: float = 0.0,
    *, first: tuple[int, int] = (0, 0),
) -> PixelRays:  # fmt: skip
    """Return where the ray of every pixel runs in the resin and how much of its light arrives there.

    The vial is a lens: it narrows what a pixel lights by the ratio of areas ``dx_v dz_mid / (dx_c dz_c)``.  Reflection
    at both faces of the glass takes its share, and absorption over the half-chord up to the point closest to the axis.

    Parameters
    ----------
    columns, rows
        Of the image, or of a part of it.
    camera, optics
        As the rig has them; no optics for light without a vial: all of it is delivered.
    absorption_per_mm
        Napierian, of the resin.
    first
        Row and column of the first pixel, of a part of the image.
    """
    x_c = (first[1] + np.arange(columns, dtype=np.float64) - camera.axis_column) * camera.pixel_mm
    z_c = (camera.optical_row - first[0] - np.arange(rows, dtype=np.float64))[:, None] * camera.pixel_mm
    if optics is None:
        x_c, z_c = np.tile(x_c, (rows, 1)), np.tile(z_c, (1, columns))
        pixel, one = np.full(x_c.shape, camera.pixel_mm), np.ones(x_c.shape)
        return PixelRays(x_c, np.zeros(x_c.shape), z_c, pixel, pixel, one)
    rays = camera_to_virtual(x_c, z_c, optics)
    half = camera.pixel_mm / 2
    left, right = (camera_to_virtual(x_c + side, z_c, optics).virtual_x_mm for side in (-half, half))
    lower, upper = (camera_to_virtual(x_c, z_c + side, optics).mid_height_mm for side in (-half, half))
    width, height = right - left, upper - lower
    area_ratio = width * height / camera.pixel_mm**2
    half_chord = np.sqrt(np.maximum(optics.inner_radius_mm**2 - rays.virtual_x_mm**2, 0)) * np.sqrt(1 + rays.slope**2)
    share = transmission(x_c, z_c, optics) * np.exp(-absorption_per_mm * half_chord)
    delivery = np.nan_to_num(share / area_ratio, nan=0.0, posinf=0.0)
    return PixelRays(rays.virtual_x_mm, rays.direction_rad, rays.mid_height_mm, width, height, delivery)
