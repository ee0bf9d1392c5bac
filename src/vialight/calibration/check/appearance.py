"""How sharp and bright a recording is: by the streaks of light at the vial's edges, and by the edges of the part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from vialight.calibration.edges import track_edges
from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.config import Camera, Optics

_REACH = 6.0
"""Columns on either side of a streak."""
_STEP = 3
"""Pixels on either side of an edge, between which the light changes."""
_SHARPEST = 25.0
"""Per cent of the edges: the others belong to what is smooth, not out of focus."""
_FEWEST = 50


@dataclass(frozen=True)
class Streaks:
    """The light at the vial's edges.

    Parameters
    ----------
    columns
        Standard deviation across, mean of those that show.
    counts
        Sum across one, over what lies beside: the light, in focus or not.
    middle
        Column midway between the two; NaN where only one shows.
    """

    columns: float
    counts: float
    middle: float


def streaks_of(profiles: FloatArray, camera: Camera, optics: Optics) -> Streaks | None:
    """Measure the light at the vial's edges; None where it does not show.

    Parameters
    ----------
    profiles
        (frame, column) as recorded, mean over rows.
    camera, optics
        As the rig has them; the edges within some columns.

    Examples
    --------
    >>> camera = Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=87.5, optical_row=60.0)
    >>> column = np.arange(176)
    >>> seen = 45 + sum(60 * np.exp(-(((column - at) / 2) ** 2) / 2) for at in (7.3, 167.7))
    >>> round(streaks_of(np.tile(seen, (3, 1)), camera, Optics(12.4, 11.3, 1.472, 1.48, 190.0)).middle, 2)
    87.5
    """
    edges = track_edges(profiles, camera, optics)
    offset = np.arange(-_REACH, _REACH + 0.25, 0.5)
    column = np.arange(profiles.shape[1])
    found = []
    for places in (edges.left, edges.right):
        seen = np.isfinite(places)
        if seen.mean() < 0.5:
            found.append((np.nan, np.nan, np.nan))
            continue
        # Each frame about its own streak, which goes to and fro with the run-out.
        near = zip(places[seen], profiles[seen], strict=True)
        shape = np.mean([np.interp(place + offset, column, profile) for place, profile in near], axis=0)
        start = [float(np.ptp(shape)), 0.0, 1.5, float(shape.min()), 0.0]
        height, _, width, _, _ = least_squares(_off_bell, start, args=(offset, shape), x_scale=[10, 1, 1, 10, 1]).x
        found.append((abs(width), height * abs(width) * np.sqrt(2 * np.pi), np.median(places[seen])))
    width, light, place = np.array(found).T
    if not np.isfinite(width).any():
        return None
    return Streaks(float(np.nanmean(width)), float(np.nanmean(light)), float(place.mean()))


def sharpest_edges(counts: Float32Array) -> float | None:
    """Return the standard deviation, in pixels, by which the sharpest edges of what has cured are soft.

    None where too few edges show.  It depends on the part too: a ball has no sharp edges.

    Parameters
    ----------
    counts
        (frame, row, column) above the background.

    Examples
    --------
    >>> from scipy.ndimage import gaussian_filter
    >>> part = np.zeros((2, 60, 80), np.float32)
    >>> part[:, 20:40, 20:60] = 500
    >>> [round(sharpest_edges(gaussian_filter(part, (0, s, s))), 1) for s in (1.0, 2.0)]
    [1.2, 1.8]
    """
    noise = 1.4826 * float(np.median(np.abs(np.diff(counts, axis=2)))) / np.sqrt(2)
    steps, widths = [], []
    for values in (counts, counts.swapaxes(1, 2)):
        if values.shape[2] < 2 * _STEP + 3:
            continue
        middle = values[..., _STEP:-_STEP]
        slope = np.abs(values[..., _STEP + 1 : values.shape[2] - _STEP + 1] - values[..., _STEP - 1 : -_STEP - 1]) / 2
        step = np.abs(values[..., 2 * _STEP :] - values[..., : -2 * _STEP])
        steepest = np.zeros(middle.shape, np.bool_)
        steepest[..., 1:-1] = (slope[..., 1:-1] >= slope[..., :-2]) & (slope[..., 1:-1] > slope[..., 2:])
        steps.append(step[steepest])
        widths.append(step[steepest] / np.maximum(slope[steepest], 1e-12) / np.sqrt(2 * np.pi))
    step, width = np.concatenate(steps), np.concatenate(widths)
    if not len(step):
        return None
    clear = step > max(10 * noise, 0.3 * float(np.percentile(step, 99)), 1e-6)
    return float(np.percentile(width[clear], _SHARPEST)) if clear.sum() >= _FEWEST else None


def _off_bell(values: FloatArray, offset: FloatArray, shape: FloatArray) -> FloatArray:
    height, middle, width, level, slope = values
    return np.asarray(height * np.exp(-(((offset - middle) / width) ** 2) / 2) + level + slope * offset - shape)
