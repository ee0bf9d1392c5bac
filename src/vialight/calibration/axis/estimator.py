"""Where the rotation axis is, how it leans, how the vial goes round it, and which way the stage turns."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vialight.calibration.axis.jitter import Jitter, find_jitter
from vialight.calibration.edges import EdgeCircle, Edges, fit_circle, track_edges
from vialight.calibration.opposite_views import (
    AXIS,
    FIRST_LOOK,
    LAST_LOOK,
    OUT_X,
    OUT_Y,
    PRIOR,
    Fit,
    ViewComparison,
    Views,
    compare,
    fit,
    smoothed_splines,
)
from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError

SEARCH_COLUMNS = 12
"""How far the axis may lie from where the rig has it."""

MODEL_STD = np.array([0.002, np.radians(0.005), 0.001, 0.001, 0.001])
"""Standard uncertainties of the model itself, as `PRIOR`: twice the errors, or more, that are left without noise."""

EDGE_STD_MM = 0.001
"""As above, of the run-out as the vial's edges have it."""

COARSE_ROWS = 8
"""Compared at a first look."""

LEFT_ALONE = 0.3
"""A parameter whose standard uncertainty is more than this share of its span is left alone."""

_SURE_OF_DIRECTION = 1.1


@dataclass(frozen=True)
class AxisFit:
    """What opposite views, and the vial's edges where they show, say of the axis.

    Parameters
    ----------
    fit
        Parameters and their covariance.
    determined
        (5,) which of the parameters the frames determine.
    direction
        1 or -1: the sense in which the file's angles count; None where both agree with the frames.
    ratio_of_directions
        Of the RMS differences: the wrong sense over the right one.
    before
        Opposite views compared as the rig had it.
    jitter
        Of the frames' angles.
    edges, edge_angles_rad, circle
        The vial's edges in every frame, in the order of recording, its angles, and the circle that they go on; None
        where they do not show.
    views
        The frames that were compared.
    """

    fit: Fit
    determined: np.ndarray
    direction: int | None
    ratio_of_directions: float
    before: ViewComparison
    jitter: Jitter
    edges: Edges | None
    edge_angles_rad: FloatArray
    circle: EdgeCircle | None
    views: Views


def symmetric_centre(profile: FloatArray, about: float, search: int = SEARCH_COLUMNS) -> float:
    """Return the column about which the mean of all frames is symmetric, as it is about the axis.

    Every ray comes back as its mirror image in the course of a turn, whichever way the stage goes and however the vial
    bends it.

    Parameters
    ----------
    profile
        (column,) mean counts above the background over a whole turn.
    about
        Column to look about.
    search
        Columns on either side.

    Raises
    ------
    InputError
        The best column is at the end of the search.

    Examples
    --------
    >>> column = np.arange(60)
    >>> round(symmetric_centre(np.exp(-(((column - 31.3) / 6.0) ** 2)), 29.0), 1)
    31.3
    """
    fine = np.arange(-2 * search, 2 * search + 1) / 2 + np.round(2 * about) / 2
    unlike = []
    for centre in fine:
        reach = min(centre, len(profile) - 1 - centre)
        offset = np.arange(0.25, reach, 0.5)
        columns = np.arange(len(profile))
        right, left = (np.interp(centre + side * offset, columns, profile) for side in (1, -1))
        unlike.append(((right - left) ** 2).sum() / ((right + left) ** 2).sum())
    best = int(np.argmin(unlike))
    if best in (0, len(fine) - 1):
        raise InputError(
            "frames", f"opposite views agree nowhere within {search} columns of axis_column {about:g}",
            accepted="an axis_column nearer to the axis", remedy="correct it in the rig by a look at a frame",
        )  # fmt: skip
    below, here, above = unlike[best - 1 : best + 2]
    return float(fine[best] + 0.25 * (below - above) / (below - 2 * here + above))


def find_axis(
    counts: Float32Array,
    first_row: int,
    angles_rad: FloatArray,
    camera: Camera,
    optics: Optics | None,
    *,
    direction: int = 1,
    profiles: FloatArray | None = None,
) -> AxisFit:
    """Find axis, tilt, run-out, the light's drift, the turning sense and the angles' jitter from one turn.

    Parameters
    ----------
    counts
        (frame, row, column) above the background, in the order of recording.
    first_row
        Of the image, that the counts begin with.
    angles_rad
        (frame,) as the file has them, of one turn, no two the same.
    camera, optics
        As the rig has them; no optics for data without a vial.
    direction
        As the rig has it: kept where the frames do not tell.
    profiles
        (frame, column) counts with the background, mean over rows, for the vial's edges.

    Raises
    ------
    InputError
        Opposite views agree nowhere near.
    """
    centre = symmetric_centre(counts.mean(axis=(0, 1), dtype=np.float64), camera.axis_column)
    time = (np.arange(len(counts)) + 0.5) / len(counts) - 0.5

    def views(sense: int, row_step: int | None = None) -> Views:
        wrapped = np.mod(sense * angles_rad, 2 * np.pi)
        order = np.argsort(wrapped, kind="stable")
        made = Views(counts[order], wrapped[order], time[order], first_row, camera, optics)
        return made if row_step is None else replace(made, row_step=row_step)

    start = np.array([centre, 0.0, 0.0, 0.0, 0.0])
    coarse_step = max(2, counts.shape[1] // COARSE_ROWS)
    coarse = {sense: fit(views(sense, coarse_step), start, smoothing=FIRST_LOOK) for sense in (1, -1)}
    ratio = coarse[-direction].comparison.rms / coarse[direction].comparison.rms
    told = max(ratio, 1 / ratio) > _SURE_OF_DIRECTION and optics is not None
    sense = direction if ratio >= 1 or not told else -direction
    seen = views(sense)
    found = fit(seen, coarse[sense].parameters, smoothing=LAST_LOOK)
    edges = circle = None
    if optics is not None and profiles is not None:
        about = camera.model_copy(update={"axis_column": float(found.parameters[AXIS])})
        edges = track_edges(profiles, about, optics)
        circle = fit_circle(edges, sense * angles_rad, about, optics)
    found = _with_edges(found, circle)
    # Wide, so that what differs between frames is their angles and not what an interpolation of them misses.
    wide = smoothed_splines(seen, FIRST_LOOK, among_frames=False)
    coefficients = smoothed_splines(seen, LAST_LOOK)
    compared = compare(_at(seen, found.parameters), coefficients, found.parameters)
    before = np.zeros(5)
    before[AXIS] = camera.axis_column
    return AxisFit(
        replace(found, comparison=compared), found.std <= LEFT_ALONE * PRIOR, sense if told else None,
        max(ratio, 1 / ratio), compare(seen, coefficients, before),
        find_jitter(compare(_at(seen, found.parameters), wide, found.parameters), seen.angles_rad), edges,
        sense * angles_rad, circle, seen,
    )  # fmt: skip


def _at(views: Views, parameters: FloatArray) -> Views:
    return replace(views, camera=views.camera.model_copy(update={"axis_column": float(parameters[AXIS])}))


def _with_edges(found: Fit, circle: EdgeCircle | None) -> Fit:
    """Add the model's own uncertainty, then what the edges say of the run-out, each by its weight."""
    covariance = found.covariance + np.diag(MODEL_STD**2)
    if circle is None or not np.isfinite(circle.run_out_mm).all():
        return replace(found, covariance=covariance)
    place = [OUT_X, OUT_Y]
    told = circle.covariance_mm2 + EDGE_STD_MM**2 * np.eye(2)
    gain = covariance[:, place] @ np.linalg.inv(covariance[np.ix_(place, place)] + told)
    off = circle.run_out_mm - found.parameters[place]
    return replace(found, parameters=found.parameters + gain @ off, covariance=covariance - gain @ covariance[place])
