"""Projections that were computed elsewhere, laid into the vial as they are."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid, centred
from vialight.core.errors import InputError
from vialight.planning.projections.forward import Light
from vialight.planning.strips import StripGeometry


def lay_in_vial(
    values: Float32Array, angles_rad: FloatArray, pixel_mm: float, centre_z_mm: float
) -> tuple[Float32Array, Light, Grid]:
    """Say where given projections lie, so that `make_patterns` can resample them like our own.

    Parameters
    ----------
    values
        (angle, row, column) light as parallel rays would bring it to a bare part: row 0 on top; columns to the right
        as seen along the rays; the axis in the middle.
    angles_rad
        (angle,) rising evenly over half a turn, whose opposite is then taken to be its mirror image, or a full turn.
    pixel_mm
        Width of a column and height of a row, in the part.
    centre_z_mm
        Height of the middle row.

    Returns
    -------
    projections : numpy.ndarray
        (psi, s, z).
    light : Light
        Their geometry.
    grid : Grid
        Whose slices are their rows.

    Raises
    ------
    InputError
        The angles are not even, or cover neither half a turn nor a full one.
    """
    count, rows, columns = values.shape
    steps = np.diff(angles_rad)
    step = float(np.median(steps)) if count > 1 else 0.0
    span = count * step
    is_half, is_full = (abs(span - turn) < step / 2 for turn in (np.pi, 2 * np.pi))
    if step <= 0 or np.abs(steps - step).max() > 1e-3 * step or not (is_half or is_full):
        raise InputError(
            "--projections", f"{count} angles from {np.degrees(angles_rad[0]):g} deg span {np.degrees(span):g} deg",
            accepted="even, rising angles over 180 or 360 deg", remedy="resample them, or give the span",
        )  # fmt: skip
    if not (np.isfinite(pixel_mm) and pixel_mm > 0):
        raise InputError("--projection-pixel", f"is {pixel_mm}", accepted="a positive length in mm")
    s_mm = centred(columns, pixel_mm)
    geometry = StripGeometry(
        angles_rad, float(s_mm[0]), pixel_mm, columns, s_mm, s_mm, from_both_sides=bool(is_half)
    )  # fmt: skip
    projections = np.ascontiguousarray(values[:, ::-1].transpose(0, 2, 1))
    return projections, Light(geometry), Grid((rows, columns, columns), pixel_mm, centre_z_mm)
