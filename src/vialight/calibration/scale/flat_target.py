"""Scale, optical row and distortion from a flat target, seen plainly or through the vial.

Each point of the target that is seen is followed back along its pixel's ray to the target's plane, and compared there
with where the target has it.  In air the ray is straight, in the vial it is that of `vialight.optics.refraction`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from vialight.calibration.scale.flat_target_places import (
    COLUMN,
    DEPTH,
    DISTANCE,
    DISTORTION,
    INDEX,
    PITCH,
    PIXEL,
    RIGHT,
    ROLL,
    ROW,
    UP,
    YAW,
    Known,
    places_on_target,
    slopes_on_target,
)
from vialight.calibration.scale.flat_target_points import Bend, GridPoints
from vialight.core.arrays import BoolArray, FloatArray, IntArray
from vialight.core.errors import InputError

MOST_TILT_DEG = 15.0
MOST_LEFT_OVER = 0.3
"""Pixels, RMS, beyond which what is seen is no such target."""
_LEAST_KEPT = 0.7
_EDGE = 0.9
"""Of the vial's radius: beyond it rays are bent so much that the wall decides."""
_WIDE = {ROW: 20.0, COLUMN: 20.0, DISTORTION: 5.0, ROLL: 1.0, YAW: 0.3, PITCH: 0.3, PIXEL: 1.0, RIGHT: 1e3, UP: 1e3}
"""Standard deviations before anything is seen: so wide that they hardly count, yet keep in place what is not seen."""
_PASSES, _STEPS = 3, 4
_FAR = 1e3
"""Pixels, by which what is not met counts as off."""
_UNEVEN = 0.01
"""Pixels by which the shape of points misleads, in all views alike."""


@dataclass(frozen=True)
class TargetView:
    """A target in one position of the stage.

    Parameters
    ----------
    angle_rad
        Of the stage, counter-clockwise seen from above.
    points
        What is seen.
    """

    angle_rad: float
    points: GridPoints

    @property
    def width_of_a_step(self) -> float:
        """Columns from point to point in the middle, which are most where it faces the camera."""
        points = self.points
        near = np.abs(points.columns - np.median(points.columns)) < 0.25 * np.ptp(points.columns)
        design = np.stack([points.across, points.up, np.ones(len(points.up))], axis=1)[near]
        return float(np.linalg.lstsq(design, points.columns[near], rcond=None)[0][0])


@dataclass(frozen=True)
class TargetFit:
    """What a target tells.

    Parameters
    ----------
    values, covariance
        See `PIXEL` and those that follow.
    known
        What it started from.
    views, kept
        All views, the one that faces the camera most first; depth, yaw and pitch are those in it.  (point,) which of
        their points count.
    left_over
        (point, 2) columns and rows by which points are off.
    """

    values: FloatArray
    covariance: FloatArray
    known: Known
    views: Sequence[TargetView]
    kept: BoolArray
    left_over: FloatArray

    @property
    def std(self) -> FloatArray:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def pixel_mm(self) -> float:
        """In the plane of the axis."""
        return self.known.camera.pixel_mm * float(np.exp(self.values[PIXEL]))

    @property
    def rms(self) -> float:
        """Pixels by which the points that count are off, along a row or a column."""
        return float(np.sqrt((self.left_over[self.kept] ** 2).mean()))


def fit_target(
    views: Sequence[TargetView], known: Known, where: object = "", *, start: TargetFit | None = None
) -> TargetFit:
    """Fit a camera and a target's place to what is seen of it, in one position of the stage or several.

    Parameters
    ----------
    views
        One at the least; the one that faces the camera most is taken for level with it to 15 deg.
    known
        Before.
    where
        Named in errors.
    start
        Of the same views, whose points have since been moved a little.

    Raises
    ------
    InputError
        What is seen is no flat target of this pitch, or it is turned away from the camera.

    Examples
    --------
    >>> from vialight.core.config import Camera
    >>> up, across = (values.ravel() for values in np.mgrid[-5:6, -6:7])
    >>> camera = Camera(distance_mm=190.0, pixel_mm=0.15, axis_column=80.0, optical_row=60.0)
    >>> points = GridPoints(80 + across / 0.155, 60 - up / 0.155, across, up)
    >>> fit = fit_target([TargetView(0.0, points)], Known(1.0, camera, None, (120, 160)))
    >>> round(fit.pixel_mm, 5), round(0.155 * float(fit.std[PIXEL]), 5)  # a depth of 0.3 mm of 190
    (0.155, 0.00024)
    """
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # of what is no target: it is refused
        return _fitted(views, known, where, start)


def _fitted(views: Sequence[TargetView], known: Known, where: object, start: TargetFit | None) -> TargetFit:
    if start is None:
        front = max(views, key=lambda view: view.width_of_a_step)
        fit = _fit([front], known, None)
        _check(fit, where)
        # From view to view a point moves by less than the pitch once the plane's depth is known a little.
        for view in sorted(views, key=lambda view: abs(view.angle_rad - front.angle_rad))[1:]:
            fit = _fit([*fit.views, _renumbered(view, fit)], known, fit.values)
    else:
        fit = _fit(views, known, start.values)
    _check(fit, where)
    return fit


def bend_of(fit: TargetFit, view: TargetView) -> Bend:
    """Return by how much a view of a fitted target is uneven, as `centred` of `flat_target_points` takes it."""
    turned = np.asarray(view.angle_rad - fit.views[0].angle_rad)

    def met(columns: FloatArray, rows: FloatArray) -> FloatArray:
        return places_on_target(fit.values, columns, rows, np.broadcast_to(turned, columns.shape), fit.known)

    def bend(columns: FloatArray, rows: FloatArray, right: FloatArray, down: FloatArray) -> FloatArray:
        uneven = met(columns + right, rows + down) + met(columns - right, rows - down) - 2 * met(columns, rows)
        slopes = slopes_on_target(fit.values, columns, rows, np.broadcast_to(turned, columns.shape), fit.known)
        bent = np.linalg.pinv(slopes) @ uneven[..., None]
        return np.asarray(np.nan_to_num(-bent[..., 0] / 2))

    return bend


def _fit(views: Sequence[TargetView], known: Known, start: FloatArray | None) -> TargetFit:
    columns, rows, across, up = (
        np.concatenate([getattr(view.points, name) for view in views]) for name in ("columns", "rows", "across", "up")
    )
    turned = np.concatenate([np.full(len(v.points.rows), v.angle_rad - views[0].angle_rad) for v in views])
    wanted = known.pitch_mm * np.stack([across, up], axis=1)
    spread = _spreads(known)
    steps = np.diag(1e-4 * np.minimum(spread, 1))
    values = _start(columns, rows, wanted, known) if start is None else start
    seen = _is_inside(columns, values, known)

    prior = np.zeros(len(spread))
    prior[ROW], prior[COLUMN] = known.camera.optical_row, known.camera.axis_column
    kept, noise = seen, 0.1
    for _ in range(_PASSES):
        pixels_a_mm = np.asarray(np.linalg.pinv(slopes_on_target(values, columns, rows, turned, known)), np.float64)

        def off(values: FloatArray, scale: FloatArray = pixels_a_mm) -> FloatArray:
            """Return (point, 2) columns and rows."""
            met = places_on_target(values, columns, rows, turned, known)
            apart = (scale @ (met - wanted)[..., None])[..., 0]
            return np.asarray(np.clip(np.nan_to_num(apart, nan=_FAR), -_FAR, _FAR))

        used, before = kept, noise
        for _ in range(_STEPS):
            left = off(values)
            change = np.stack([(off(values + step) - left)[used].ravel() / step.max() for step in steps], axis=1)
            normal = change.T @ change / before**2 + np.diag(spread**-2.0)
            pull = change.T @ left[used].ravel() / before**2 + (values - prior) / spread**2
            values = values - np.clip(np.linalg.solve(normal, pull), -spread, spread)
        left = off(values)
        noise = max(1.4826 * float(np.median(np.abs(left[seen]))), 1e-3)
        kept = seen & (np.abs(left).max(axis=1) < 5 * noise)
    identity = np.unique(np.stack([across, up], axis=1)[used], axis=0, return_inverse=True)[1].ravel()
    covariance = _covariance(
        change / before, left[used].ravel() / before, identity, spread, len(views) * (_UNEVEN / before) ** 2
    )
    return TargetFit(values, covariance, known, views, used, left)


def _spreads(known: Known) -> FloatArray:
    spread = np.ones(12)
    for place, value in _WIDE.items():
        spread[place] = value
    spread[DEPTH], spread[DISTANCE] = known.depth_std_mm, max(known.distance_std, 1e-6)
    spread[INDEX] = max(known.index_std, 1e-6)
    return spread


def _start(columns: FloatArray, rows: FloatArray, wanted: FloatArray, known: Known) -> FloatArray:
    """Return the rig's camera with a pixel that suits the target, and the target where it then is."""
    values = np.zeros(12)
    values[ROW], values[COLUMN] = known.camera.optical_row, known.camera.axis_column
    for _ in range(2):
        values[RIGHT] = values[UP] = values[ROLL] = 0.0
        met = places_on_target(values, columns, rows, np.zeros(len(rows)), known)
        good = np.isfinite(met).all(axis=1)
        design = np.column_stack([wanted[good], np.ones(good.sum())])
        (a, c), (b, d), middle = np.linalg.lstsq(design, met[good], rcond=None)[0]
        values[PIXEL] -= np.log(np.hypot(b, d) if known.optics else np.sqrt(abs(a * d - b * c)))
        values[ROLL] = np.arctan2(-c, a)
    cosine, sine = np.cos(values[ROLL]), np.sin(values[ROLL])
    values[RIGHT], values[UP] = cosine * middle[0] - sine * middle[1], sine * middle[0] + cosine * middle[1]
    return values


def _is_inside(columns: FloatArray, values: FloatArray, known: Known) -> BoolArray:
    if known.optics is None:
        return np.ones(len(columns), np.bool_)
    x_c = np.abs(columns - values[COLUMN]) * known.camera.pixel_mm * np.exp(values[PIXEL])
    return np.asarray(x_c < _EDGE * known.optics.outer_radius_mm)


def _covariance(
    change: FloatArray, off: FloatArray, identity: IntArray, spread: FloatArray, common: float
) -> FloatArray:
    """Return the covariance, what is wrong with a point of the target being wrong with it in all views.

    ``common`` is the variance, over that of the noise, of what is wrong with a point in any picture of it.
    """
    priors = np.diag(spread**-2.0)
    inverse = np.linalg.inv(change.T @ change + priors)
    pulls = np.zeros((int(identity.max()) + 1, len(spread)))
    np.add.at(pulls, np.repeat(identity, 2), change * off[:, None])
    few = len(pulls) / max(len(pulls) - len(spread), 1)
    return np.asarray(inverse @ (few * pulls.T @ pulls + common * change.T @ change + priors) @ inverse)


def _renumbered(view: TargetView, fit: TargetFit) -> TargetView:
    """Return a view whose points have the numbers of what was fitted."""
    points = view.points
    turned = np.full(len(points.rows), view.angle_rad - fit.views[0].angle_rad)
    met = places_on_target(fit.values, points.columns, points.rows, turned, fit.known) / fit.known.pitch_mm
    shift = np.rint(np.nanmedian(met - np.stack([points.across, points.up], axis=1), axis=0)).astype(int)
    return replace(view, points=replace(points, across=points.across + shift[0], up=points.up + shift[1]))


def _check(fit: TargetFit, where: object) -> None:
    share = float(fit.kept.mean())
    if not fit.rms <= MOST_LEFT_OVER or share < _LEAST_KEPT:
        through = "in air" if fit.known.optics is None else "in the vial"
        raise InputError(
            where, f"what is seen is no flat target of {fit.known.pitch_mm:g} mm {through}: its points are off by "
            f"{fit.rms:.2f} pixels RMS, {1 - share:.0%} of them do not belong",
            accepted=f"points that fit to {MOST_LEFT_OVER} pixels",
            remedy="check the pitch, --in-vial, and that the target is flat and sharp",
        )  # fmt: skip
    for name, place in (("about the vertical", YAW), ("forwards or backwards", PITCH)):
        tilt = float(np.degrees(fit.values[place]))
        if abs(tilt) > MOST_TILT_DEG:
            raise InputError(
                where, f"the target leans by {abs(tilt):.0f} deg {name} out of the plane of the axis",
                accepted=f"{MOST_TILT_DEG:g} deg at most", remedy="turn the stage until it faces the camera",
            )  # fmt: skip
