"""Which rays a sinogram has, and which rows of the frames they are read from."""

from __future__ import annotations

import warnings

import numpy as np

from vialight.core.arrays import TURN_RAD, FloatArray, ParallelBeam, centred
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError, VialightWarning
from vialight.optics.viewing import EDGE_MARGIN, rows_of, vial_edge_columns
from vialight.tomography.sinogram.turns import WIDEST_GAP_RAD, nominal_step, sorted_turn, widest_gap

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


def _check_vial_in_image(columns: int, camera: Camera, optics: Optics) -> None:
    """Refuse an image that neither on the left nor on the right reaches to the edge of the field."""
    first, last = vial_edge_columns(camera, optics)
    if first < -0.5 and last > columns - 0.5:
        raise InputError(
            "[vial]", f"the vial spans columns {first:.1f} to {last:.1f}, the image has 0 to {columns - 1}",
            accepted="a vial that is seen to its edge on one side at least",
            remedy="correct outer_radius_mm, pixel_mm or the binning",
        )  # fmt: skip


def warn_of_unseen_rays(angles_rad: FloatArray, columns: int, camera: Camera) -> None:
    """Say how far from the axis parallel rays see everything, where half a turn and an axis off centre leave rays out.

    Parameters
    ----------
    angles_rad, columns, camera
        As for `parallel_beam`.

    Warns
    -----
    VialightWarning
        Rays on the wider side of the axis are seen from one side only.
    """
    left, right = camera.axis_column, columns - 1 - camera.axis_column
    if abs(left - right) > 1 and widest_gap(sorted_turn(angles_rad)[1])[1] > WIDEST_GAP_RAD:
        warnings.warn(
            f"half a turn about an axis {abs(left - right) / 2:.1f} columns off the image's middle sees all that lies "
            f"within {min(left, right) * camera.pixel_mm:.4g} mm of the axis; farther out some rays are missing, "
            "which count as zero: record a full turn",
            VialightWarning,
            stacklevel=2,
        )


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
    row = rows_of(x_c, z_mm[[0, -1]], camera, optics)
    return slice(max(0, int(row.min()) - ROW_MARGIN), min(rows, int(row.max()) + 1 + ROW_MARGIN))
