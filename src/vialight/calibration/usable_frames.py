"""Are frames fit to calibrate from? Something cured, a full turn, no pixel at its limit."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError
from vialight.tomography.sinogram.turns import check_gaps, sorted_turn

_LIT = 0.5
_ROWS_WANTED, _FEWEST_ROWS = 64, 24
_CLIMB_PIXELS = 0.5

LEAST_SIGNAL = 1.0
"""Brightest pixel of the mean frame over one pixel's noise: below this nothing has cured."""

MOST_SATURATED = 1e-4
"""Share of pixels that may stand at the highest count."""

_PILED_UP = 20


def check_turn(angles_rad: FloatArray) -> None:
    """Refuse angles that leave out more of a turn than 30 deg: opposite views are what calibration rests on."""
    check_gaps(sorted_turn(angles_rad)[1], half_turn_suffices=False)


def check_unsaturated(counts: NDArray[Any], where: object) -> None:
    """Refuse images in which pixels pile up at the highest count.

    Parameters
    ----------
    counts
        As recorded.
    where
        Named in errors.
    """
    highest = counts.max()
    at = int(np.count_nonzero(counts == highest))
    below = int(np.count_nonzero(counts >= highest * 0.97)) - at
    if highest > 0 and at > MOST_SATURATED * counts.size and at > _PILED_UP and at > below:
        raise InputError(
            where, f"{at} of {counts.size} pixels stand at {highest}, the highest count: the image is saturated",
            accepted="images without pixels at their limit", remedy="record with a shorter exposure or less gain",
        )  # fmt: skip


def check_something_cured(counts: Float32Array, where: object) -> None:
    """Refuse frames in which nothing stands out from the background.

    Parameters
    ----------
    counts
        (frame, row, column) above the background.
    where
        Named in errors.
    """
    mean = counts.mean(axis=0)
    noise = 1.4826 * float(np.median(np.abs(counts[1:] - counts[:-1]))) / np.sqrt(2)
    brightest = float(np.percentile(mean, 99.5) - np.median(mean[:, :3]))
    if brightest < LEAST_SIGNAL * noise or brightest <= 0:
        raise InputError(
            where, f"nothing has cured: the mean frame is {brightest:.1f} counts above the background at its "
            f"brightest, one pixel's noise is {noise:.1f}",
            accepted="frames of a print", remedy="choose a later --turn, or record data_dark before anything cures",
        )  # fmt: skip


def rows_to_compare(counts_by_row: FloatArray, camera: Camera, optics: Optics | None) -> slice:
    """Choose rows that are lit and whose rays hardly climb: near the optical row.

    Parameters
    ----------
    counts_by_row
        (row,) mean counts above the background.
    camera, optics
        As the rig has them; no optics for data without a vial, where no ray climbs.
    """
    smooth = ndimage.gaussian_filter1d(counts_by_row, 1.0)
    lit = np.flatnonzero(smooth > _LIT * smooth.max())
    reach = np.inf
    if optics is not None:
        # Across half of the field, a ray climbs by less than `_CLIMB_PIXELS`.
        climb = 0.6 * optics.field_radius_mm / (optics.distance_mm * optics.resin_index)
        reach = max(_CLIMB_PIXELS / climb if climb else np.inf, _FEWEST_ROWS / 2)
    order = lit[np.argsort(np.abs(lit - camera.optical_row), kind="stable")]
    near = order[np.abs(order - camera.optical_row) <= reach]
    near = near if len(near) >= _FEWEST_ROWS // 2 else order[:_FEWEST_ROWS]
    near = near[:_ROWS_WANTED]
    return slice(max(0, int(near.min()) - 3), min(len(counts_by_row), int(near.max()) + 4))
