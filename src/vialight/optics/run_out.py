"""A vial whose axis is not the stage's, and an axis that leans: where a pixel of the ideal camera is really seen.

Vial and resin turn about the stage's axis together.  Where the vial's own axis lies off it by (e_x, e_y) in the
object's frame, it goes round on a circle; in the vial's frame nothing changes but the place of the camera.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from vialight.core.arrays import FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.core.config import RunOut

Offset = tuple[float, float]


def vial_centre_mm(run_out: RunOut | None) -> Offset:
    """Return x and y of the vial's axis in the object's frame.

    Examples
    --------
    >>> vial_centre_mm(RunOut(radius_mm=0.2, phase_deg=0.0))
    (0.2, 0.0)
    """
    if run_out is None:
        return 0.0, 0.0
    phase = np.radians(run_out.phase_deg)
    return float(run_out.radius_mm * np.cos(phase)), float(run_out.radius_mm * np.sin(phase))


def seen_from_the_vial(angles_rad: FloatArray, centre_mm: Offset, distance_mm: float) -> FloatArray:
    """Return the stage angles at which a vial on its axis would look alike: the line of sight turns as it goes aside.

    Parameters
    ----------
    angles_rad
        Of the stage.
    centre_mm
        See `vial_centre_mm`.
    distance_mm
        From pupil to axis.
    """
    x, y = centre_mm
    return np.asarray(angles_rad + (x * np.cos(angles_rad) - y * np.sin(angles_rad)) / distance_mm)


@njit(fastmath=FAST_MATH, cache=True)
def really_seen(
    x_c: float, z_c: float, cosine: float, sine: float, out_x: float, out_y: float, tilt: float, distance: float
) -> Offset:
    """Return where, in the axis plane, a camera sees what it would see at x_c, z_c if all stood straight.

    Parameters
    ----------
    x_c, z_c
        In the axis plane, mm.
    cosine, sine
        Of the stage's angle.
    out_x, out_y
        The vial's centre, see `vial_centre_mm`.
    tilt
        By which the axis leans to the right, rad.
    distance
        From pupil to axis, mm.

    Notes
    -----
    With the vial at ``(c_x, c_y)`` of the lab, to first order in c/D::

        x = x_c (1 - c_y/D) + c_x (1 + (x_c/D)^2),    z = z_c (1 - c_y/D) + c_x x_c z_c / D^2

    and then a turn of the image by the tilt.
    """
    aside = out_x * cosine - out_y * sine
    nearer = 1 - (out_x * sine + out_y * cosine) / distance
    x = x_c * nearer + aside * (1 + (x_c / distance) ** 2)
    z = z_c * nearer + aside * x_c * z_c / distance**2
    return x * np.cos(tilt) + z * np.sin(tilt), z * np.cos(tilt) - x * np.sin(tilt)
