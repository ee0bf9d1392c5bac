"""Where in the image, and from which stage angle, a ray of the sinogram is seen."""

from __future__ import annotations

import numpy as np

from vialight.arrays import FloatArray, ParallelBeam, centred
from vialight.config import Camera, Optics
from vialight.errors import InputError
from vialight.refraction import camera_to_virtual, height_to_camera, virtual_to_camera
from vialight.sinogram.turns import TURN_RAD, nominal_step, sorted_turn

EDGE_MARGIN = 0.9995
"""Share of the field that is read: at its very edge rays graze the glass and columns have no width."""

ROW_MARGIN = 10
"""Rows beside those that are read, for the splines along rows: the ends reach in by a factor of 0.27 a row."""


def parallel_beam(angles_rad: FloatArray, columns: int, camera: Camera, optics: Optics | None) -> ParallelBeam:
    """Choose the rays of the sinogram: as fine as frames and columns are.

    Parameters
    ----------
    angles_rad
        (frame,) of the turn.
    columns
        Columns of the image.
    camera, optics
        As the rig has them; no optics for data without a vial.

    Raises
    ------
    InputError
        The axis lies outside the image, the vial is wider than the image, or there are too few frames.
    """
    if not 0 <= camera.axis_column <= columns - 1:
        raise InputError(
            "[camera]", f"axis_column {camera.axis_column} lies outside the image",
            accepted=f"0 to {columns - 1}", remedy="correct it, or the binning",
        )  # fmt: skip
    if len(angles_rad) < 3:
        raise InputError("/exchange/data", f"{len(angles_rad)} frames in the turn", accepted="3 or more")
    step = nominal_step(sorted_turn(angles_rad)[1])
    count = max(4, 2 * round(np.pi / step))
    psi = angles_rad[0] + np.arange(count) * (TURN_RAD / count)
    left, right = camera.axis_column, columns - 1 - camera.axis_column
    if optics is None:
        # Even where the axis falls between two columns, so that rays and columns coincide.
        between = camera.axis_column % 1 == 0.5
        count_x = 2 * int(np.ceil(max(left, right))) + (0 if between else 1)
        return ParallelBeam(psi, centred(count_x, camera.pixel_mm))
    _check_vial_in_image(columns, camera, optics)
    spacing = camera.pixel_mm / optics.resin_index
    return ParallelBeam(psi, centred(2 * int(np.ceil(optics.field_radius_mm / spacing)), spacing))


def vial_edge_columns(camera: Camera, optics: Optics) -> tuple[float, float]:
    """Return the columns of the outermost rays that reach the resin: the vial's edges in the image."""
    edge_mm, _ = virtual_to_camera(EDGE_MARGIN * optics.field_radius_mm, 0.0, optics)
    edge = float(edge_mm) / camera.pixel_mm
    return camera.axis_column - edge, camera.axis_column + edge


def _check_vial_in_image(columns: int, camera: Camera, optics: Optics) -> None:
    """Refuse an image that neither on the left nor on the right reaches to the edge of the field."""
    first, last = vial_edge_columns(camera, optics)
    if first < -0.5 and last > columns - 0.5:
        raise InputError(
            "[vial]", f"the vial spans columns {first:.1f} to {last:.1f}, the image has 0 to {columns - 1}",
            accepted="a vial that is seen to its edge on one side at least",
            remedy="correct outer_radius_mm, pixel_mm or the binning",
        )  # fmt: skip


def rows_seen(z_mm: FloatArray, rows: int, camera: Camera, optics: Optics | None) -> slice:
    """Return the rows of the image that a stack of heights is read from.

    Parameters
    ----------
    z_mm
        (z,) ascending.
    rows
        Rows of the image.
    camera, optics
        As the rig has them.
    """
    x_c = np.zeros(1) if optics is None else EDGE_MARGIN * optics.outer_radius_mm * np.array([0.0, 1.0])
    row = _rows_of(x_c, z_mm[[0, -1]], camera, optics)
    return slice(max(0, int(row.min()) - ROW_MARGIN), min(rows, int(row.max()) + 1 + ROW_MARGIN))


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


def columns_and_directions(
    virtual_x: FloatArray, z_mid: float, camera: Camera, optics: Optics | None
) -> tuple[FloatArray, FloatArray]:
    """Return the fractional column and gamma of each ray; NaN outside the field."""
    if optics is None:
        return virtual_x / camera.pixel_mm + camera.axis_column, np.zeros_like(virtual_x)
    seen = np.where(np.abs(virtual_x) <= EDGE_MARGIN * optics.field_radius_mm, virtual_x, np.nan)
    x_c, z_c = virtual_to_camera(seen, z_mid, optics)
    direction = camera_to_virtual(x_c, z_c, optics).direction_rad
    return x_c / camera.pixel_mm + camera.axis_column, direction


def _rows_of(x_c: FloatArray, z_mm: FloatArray, camera: Camera, optics: Optics | None) -> FloatArray:
    z_c = (
        np.broadcast_to(z_mm, (len(x_c), len(z_mm))) if optics is None else height_to_camera(x_c[:, None], z_mm, optics)
    )
    return camera.optical_row - z_c / camera.pixel_mm


def rows_and_plan_share(
    columns: int, z_mm: FloatArray, camera: Camera, optics: Optics | None
) -> tuple[FloatArray, FloatArray]:
    """Return, as (column, z), the fractional row that sees a height and the cosine of its ray's climb in the resin."""
    x_c = (np.arange(columns) - camera.axis_column) * camera.pixel_mm
    if optics is not None:
        # Columns beside the vial only lend a neighbour to the cubic of the last one that sees it.
        edge, _ = virtual_to_camera(EDGE_MARGIN * optics.field_radius_mm, 0.0, optics)
        x_c = np.clip(x_c, -edge, edge)
    row = _rows_of(np.asarray(x_c, dtype=np.float64), z_mm, camera, optics)
    if optics is None:
        return row, np.ones_like(row)
    slope = camera_to_virtual(x_c[:, None], (camera.optical_row - row) * camera.pixel_mm, optics).slope
    return row, 1 / np.sqrt(1 + slope**2)
