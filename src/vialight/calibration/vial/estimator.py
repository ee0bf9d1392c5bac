"""Outer radius, index and distance: what bends the rays, from opposite views, as far as these determine them.

Opposite views know of the vial by one curve, gamma(x_c), how far a ray turns.  Radius, index and distance all change it
nearly in proportion to x_c; only the farther a ray passes from the axis, the more the curves differ in shape.  So some
combinations of the three are determined well, others hardly.  The vial's edges add its radius.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from vialight.calibration.axis.estimator import COARSE_ROWS, AxisFit
from vialight.calibration.opposite_views import (
    AXIS,
    FIRST_LOOK,
    LAST_LOOK,
    PRIOR,
    ViewComparison,
    Views,
    by_sector,
    compare,
    smoothed_splines,
)
from vialight.calibration.scale.edge_scale import STREAK_COLUMNS
from vialight.calibration.vial.bending import DISTANCE, PIXEL, bend_rad, bending, by_width, optics_of, vial_columns
from vialight.core.arrays import Float32Array, FloatArray

DETERMINED = 3.0
"""Singular values, see `VialFit`, below which a combination is left alone."""

BEND_STD_RAD = np.radians(0.01)
"""By how much the model's own bend may be wrong, RMS over the rays that tell."""

FEWEST_SIGMAS, MOST_MISFIT = 3.0, 1.5
"""Standard uncertainties from the rig's value, and RMS over noise of what is left, from which on a person is warned."""

_PASSES = 12
_SETTLED = 0.03
_NOTHING = 1e-6
"""Weight of knowing a parameter to a thousand spans, for what the data say nothing at all of."""


@dataclass(frozen=True)
class VialFit:
    """What opposite views and the vial's edges say of what bends the rays.

    Parameters
    ----------
    values, std
        (3,) outer radius (mm), index, distance (mm), and their standard uncertainties.
    before
        (3,) as the rig has them.
    widths
        (6,) standard uncertainties that were taken for what the rig has: of the three, of the wall (mm), of its index,
        of a pixel (mm).
    free
        (3,) which were refined; the others are left alone.
    singular
        (3,) singular values of the problem, descending: widths over the standard uncertainty from frames and edges
        alone, along `directions`.
    directions
        (3, 3) a row for each singular value: the combination, in widths.
    misfit
        RMS of what is left of the differences, over that of their noise.
    compared_before, compared
        Opposite views as the rig had them, and as found.
    edges
        Whether the vial's edges were used.
    views
        The frames, with optics and axis as found.
    vector, vector_before
        (6,) all that bends rays, for `bend_rad`, as found and as the rig has it.
    """

    values: FloatArray
    std: FloatArray
    before: FloatArray
    widths: FloatArray
    free: np.ndarray
    singular: FloatArray
    directions: FloatArray
    misfit: float
    compared_before: ViewComparison
    compared: ViewComparison
    edges: bool
    views: Views
    vector: FloatArray
    vector_before: FloatArray


@dataclass(frozen=True)
class _Question:
    """What is asked: frames, how many columns wide the vial is seen (None where not), and how well the rig is known.

    ``span`` (11,) is in what parameters are counted: those of the axis in their `PRIOR`, then what bends rays in
    ``widths``.
    """

    views: Views
    seen_columns: float | None
    widths: FloatArray

    @property
    def span(self) -> FloatArray:
        return np.concatenate([PRIOR, self.widths])


@dataclass(frozen=True)
class _Problem:
    """Least squares of the differences and of the vial's width about some point, over their variance, in spans.

    ``normal`` (11, 11), ``gradient`` (11,), and the gradient's covariance ``scatter`` (11, 11).
    """

    normal: FloatArray
    gradient: FloatArray
    scatter: FloatArray
    compared: ViewComparison


def find_vial(axis: AxisFit, widths: FloatArray) -> VialFit:
    """Refine outer radius, index and distance together, as far as the frames determine them.

    Parameters
    ----------
    axis
        The axis of the same frames, by `find_axis`, with a vial.
    widths
        See `VialFit`.
    """
    views, circle = axis.views, axis.circle
    assert views.optics is not None
    width = np.nan if circle is None else circle.right - circle.left
    asked = _Question(views, float(width) if np.isfinite(width) else None, widths)
    start = np.concatenate([axis.fit.parameters[:5], bending(views.optics, views.camera.pixel_mm)])
    every = np.ones(3, bool)
    fine = smoothed_splines(views, LAST_LOOK)
    coarse = replace(asked, views=replace(views, row_step=max(2, views.counts.shape[1] // COARSE_ROWS)))
    parameters, _ = _settled(coarse, start, smoothed_splines(views, FIRST_LOOK), every, prior=True)
    parameters, problem = _settled(asked, parameters, fine, every, prior=True)
    strength, directions = np.linalg.eigh(np.linalg.inv(_covariance(problem, every)[0]))
    singular = np.sqrt(np.maximum(strength[::-1], 0))
    free = _best_free(problem, int((singular >= DETERMINED).sum()))
    parameters[5:8] = np.where(free, parameters[5:8], start[5:8])
    parameters, problem = _settled(asked, parameters, fine, free)
    return VialFit(
        parameters[5:8], _std(problem, widths, free, float(parameters[5 + DISTANCE])), start[5:8], widths, free,
        singular, directions.T[::-1], _misfit(problem.compared), _problem(asked, start, fine).compared,
        problem.compared, asked.seen_columns is not None, _at(views, parameters), parameters[5:], start[5:],
    )  # fmt: skip


def bend_left(compared: ViewComparison) -> tuple[FloatArray, FloatArray]:
    """Return (x,) by how much more the rays of each pair of columns bend than they were taken to, and the uncertainty.

    Columns for themselves: nothing is assumed of how the bend changes from one to the next.
    """
    slope = -2 * compared.by_angle[1].astype(np.float64)
    weighted = np.nan_to_num(compared.weights * slope)
    weight = np.nansum(weighted * slope, axis=(0, 2))
    by_frame = (weighted * np.nan_to_num(compared.differences)).sum(axis=2)
    # Columns that nothing turns past say nothing.
    weight = np.where(weight > 1e-3 * weight.max(), weight, np.nan)
    scatter = np.array([np.sqrt(_clustered(column[:, None])[0, 0]) for column in by_frame.T])
    return -by_frame.sum(axis=0) / weight, scatter / weight


def _misfit(compared: ViewComparison) -> float:
    """Compare what is left with what of it changes between rows too far apart to share noise."""
    left = np.nan_to_num(compared.differences.astype(np.float64)) * np.sqrt(compared.weights)
    noise = (left[..., 3:] - left[..., :-3]).std() / np.sqrt(2)
    return float(np.sqrt((left**2).mean()) / max(noise, 1e-30))


def _at(views: Views, parameters: FloatArray) -> Views:
    camera = views.camera.model_copy(
        update={"axis_column": float(parameters[AXIS]), "pixel_mm": float(parameters[5 + PIXEL])}
    )
    return replace(views, camera=camera, optics=optics_of(parameters[5:]))


def _problem(asked: _Question, parameters: FloatArray, coefficients: Float32Array) -> _Problem:
    views, span, vector = _at(asked.views, parameters), asked.span, parameters[5:]
    columns, z_c = views.x_c_mm / views.camera.pixel_mm, views.z_c_mm
    slopes = by_width(lambda vector: bend_rad(vector, columns, z_c), vector, asked.widths)
    compared = compare(views, coefficients, parameters[:5], slopes / asked.widths[:, None, None])
    normal, by_frame = compared.normal.sum(axis=0) * span[:, None] * span, compared.gradient.sum(axis=0) * span
    scatter = _clustered(by_frame)
    # The differences' variance as the parameters asked for feel it.
    variance = float(np.trace(np.linalg.lstsq(normal[:8, :8], scatter[:8, :8], rcond=1e-12)[0]) / 8)
    variance = max(variance, 1e-12 * float(views.counts.max()) ** 2)
    squares = float(np.nansum(compared.weights * compared.by_angle[1].astype(np.float64) ** 2))
    normal, scatter, gradient = normal / variance, scatter / variance**2, by_frame.sum(axis=0) / variance
    scatter = (scatter + BEND_STD_RAD**2 * 4 * squares / variance * normal) / _share_of_signal(compared, squares) ** 2
    if asked.seen_columns is not None:
        std = np.sqrt(2) * STREAK_COLUMNS
        slope = np.concatenate([np.zeros(5), by_width(vial_columns, vector, asked.widths) / std])
        normal, scatter = (matrix + np.outer(slope, slope) for matrix in (normal, scatter))
        gradient = gradient + slope * (vial_columns(vector) - asked.seen_columns) / std
    return _Problem(normal, gradient, scatter, compared)


def _share_of_signal(compared: ViewComparison, squares: float) -> float:
    """Return the share of the changes with angle that is not noise: noise changes, too, and tells nothing.

    Smoothed twice over a frame, noise of a standard deviation s changes by s/2 from one to the next, and a difference
    has twice its variance; for safety it is taken as double.
    """
    step = 2 * np.pi / len(compared.differences)
    noise = (compared.rms / step) ** 2 / 4 * float(compared.weights.sum(dtype=np.float64))
    return max(1 - noise / max(squares, 1e-30), 1e-2)


def _clustered(by_frame: FloatArray) -> FloatArray:
    """Return the covariance of the sum of gradients (frame, p), whose sectors are independent."""
    sectors = by_sector(by_frame)
    sectors = sectors - sectors.mean(axis=0)
    return np.asarray(sectors.T @ sectors * len(sectors) / (len(sectors) - 1))


def _settled(
    asked: _Question, start: FloatArray, coefficients: Float32Array, free: np.ndarray, *, prior: bool = False
) -> tuple[FloatArray, _Problem]:
    """Take Gauss-Newton steps; with `prior`, as if what the rig has had been measured, which holds what is loose."""
    moving, parameters = _moving(free), start.copy()
    held = _NOTHING + (1.0 if prior else 0.0) * (moving >= 5)
    for _ in range(_PASSES):
        problem = _problem(asked, parameters, coefficients)
        off = (parameters - _rig(asked)) / asked.span if prior else np.zeros(len(parameters))
        inner = problem.normal[np.ix_(moving, moving)] + np.diag(held)
        step = np.clip(-np.linalg.solve(inner, problem.gradient[moving] + (moving >= 5) * off[moving]), -1, 1)
        parameters[moving] += step * asked.span[moving]
        if (np.abs(step) <= _SETTLED * np.sqrt(np.diag(np.linalg.inv(inner)))).all():
            break
    return parameters, _problem(asked, parameters, coefficients)


def _rig(asked: _Question) -> FloatArray:
    optics = asked.views.optics
    assert optics is not None
    return np.concatenate([np.zeros(5), bending(optics, asked.views.camera.pixel_mm)])


def _moving(free: np.ndarray) -> np.ndarray:
    """Return the places of the parameters that are fitted: those of the axis always."""
    return np.concatenate([np.arange(5), 5 + np.flatnonzero(free)])


def _covariance(problem: _Problem, free: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return the covariance (f, f) of those of the three that are free, and what all that is held adds to it."""
    moving = _moving(free)
    held = np.setdiff1d(np.arange(len(problem.gradient)), moving)
    nothing = _NOTHING * np.eye(len(moving))
    inverse = np.linalg.inv(problem.normal[np.ix_(moving, moving)] + nothing)
    own = inverse @ (problem.scatter[np.ix_(moving, moving)] + nothing) @ inverse
    along = inverse @ problem.normal[np.ix_(moving, held)]
    return own[5:, 5:], (along @ along.T)[5:, 5:]


def _best_free(problem: _Problem, count: int) -> np.ndarray:
    """Choose so many of the three that are best determined together (Golub, Klema and Stewart 1976)."""
    choices = [np.isin(np.arange(3), chosen) for chosen in combinations(range(3), count)]
    if count == 0:
        return choices[0]
    return min(choices, key=lambda free: float(np.linalg.eigvalsh(_covariance(problem, free)[0])[-1]))


def _std(problem: _Problem, widths: FloatArray, free: np.ndarray, distance_mm: float) -> FloatArray:
    """Return standard uncertainties (3,): of those left alone, what the rig is taken to have."""
    std = widths[:3].copy()
    own, by_held = _covariance(problem, free)
    std[free] *= np.sqrt(np.diag(own + by_held))
    if free[DISTANCE]:
        # Rays bend by 1/D: the longer side at 95 %, though not beyond twice what it is to first order.
        std[DISTANCE] /= max(1 - 1.96 * std[DISTANCE] / distance_mm, 0.5)
    return std
