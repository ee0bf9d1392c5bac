"""Whether the angle zero moves: the part, seen again a turn later, stands turned by so much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from vialight.calibration.opposite_sums import read_between
from vialight.calibration.opposite_views import LAST_LOOK, SMOOTHING_ROWS, by_sector
from vialight.core.arrays import Float32Array, FloatArray

_STEP_RAD = np.radians(0.1)


@dataclass(frozen=True)
class Turned:
    """By how much a part stands farther on than a turn before, at the same angles of the file.

    Parameters
    ----------
    rad, std_rad
        And its standard uncertainty.
    """

    rad: float
    std_rad: float


def turned_since(
    before: Float32Array, angles_before: FloatArray, after: Float32Array, angles_after: FloatArray
) -> Turned:
    """Compare two turns of one part, which may have grown from the one to the other.

    In every row, the later turn is the earlier one times a factor, on a level, and turned.  What a part gains where it
    has cured already is orthogonal to its turning: the sum of ``f(p) dp/dtheta`` over a turn vanishes for any f.

    Parameters
    ----------
    before, after
        (frame, row, column) counts above the background, sorted by angle.
    angles_before, angles_after
        (frame,) ascending in [0, 2 pi).

    Examples
    --------
    >>> angles = np.radians(np.arange(0, 360, 3.0))
    >>> column = np.arange(60)
    >>> def posts(angles):
    ...     first, second = 30 + 12 * np.sin(angles), 30 + 7 * np.sin(angles + 2)
    ...     return np.exp(-(((column - first[:, None]) / 3) ** 2)) + np.exp(-(((column - second[:, None]) / 2) ** 2))
    >>> before, after = (np.repeat(posts(at)[:, None], 4, axis=1) for at in (angles, angles + np.radians(0.2)))
    >>> round(float(np.degrees(turned_since(before, angles, 1.3 * after, angles).rad)), 3)
    0.2
    """
    still = np.zeros(before.shape[2])
    first, later, ahead, behind = (
        ndimage.gaussian_filter(
            read_between(frames, angles, angles_after + on, still), (0, SMOOTHING_ROWS, LAST_LOOK), mode="nearest"
        )
        for frames, angles, on in (
            (before, angles_before, 0.0), (after, angles_after, 0.0), (before, angles_before, _STEP_RAD),
            (before, angles_before, -_STEP_RAD),
        )
    )  # fmt: skip
    turning = (ahead - behind).astype(np.float64) / (2 * _STEP_RAD)
    gradient, weight = np.zeros((2, len(later)))
    for row in range(later.shape[1]):
        same = np.stack([first[:, row].ravel(), np.ones(first[:, row].size)], axis=1)
        both = np.stack([turning[:, row].ravel(), later[:, row].ravel()], axis=1)
        shares = np.linalg.lstsq(same, both, rcond=None)[0]
        by_turning, by_later = (both - same @ shares).T.reshape(2, len(later), -1)
        by_turning *= shares[0, 1]  # what grew turns by as much
        gradient += (by_turning * by_later).sum(axis=1)
        weight += (by_turning**2).sum(axis=1)
    rad = float(gradient.sum() / weight.sum())
    sectors = by_sector(gradient - rad * weight)
    return Turned(rad, float(np.sqrt((sectors**2).sum()) / weight.sum()))
