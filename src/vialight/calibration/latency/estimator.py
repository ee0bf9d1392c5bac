"""Delays of instruments: of the camera against the stage from two turns, of the projector from its flashes."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar

from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.errors import InputError

_GRID = 1024
"""Angles of a turn at which two are compared."""
_TRUSTED = 0.8
"""Share of the waves that frames can tell from each other."""
_LEAST_LIKENESS = 8.0
"""Of two turns, in standard deviations of what noise alone would give: of the grid's angles one reaches 4."""
_STEP_S = 0.0005
_LEAST_FLASHES = 3


class Found(NamedTuple):
    """A value and its standard uncertainty."""

    value: float
    uncertainty: float


class Turn(NamedTuple):
    """A turn of a thing, as it was recorded."""

    images: FloatArray
    """(frame, value): whatever was seen, as rows of a few columns."""
    angles_rad: FloatArray
    """(frame,) as recorded, over a turn at least."""
    times_s: FloatArray
    """(frame,)"""

    @property
    def speed_rad_s(self) -> float:
        """By which the angles went on, negative where they fell."""
        return float(np.polyfit(self.times_s, np.unwrap(self.angles_rad), 1)[0])


def delay_between_camera_and_stage(first: Turn, second: Turn) -> Found:
    """Return by how much the camera's times are later than the stage's, from turns at different speeds; s.

    A frame that is stamped late by `delay` is given the angle that the stage has only then: it is off by ``speed *
    delay``.  So the same view has angles in the two turns that differ by ``(second speed - first speed) * delay``.

    Raises
    ------
    InputError
        The speeds are alike, a turn is not full, or the thing looks alike from all sides.

    Examples
    --------
    >>> def turn(speed, delay):
    ...     times = np.arange(0, TURN_RAD / abs(speed) + 0.2, 0.1)
    ...     seen = speed * times[:, None] + np.arange(3)
    ...     return Turn(np.cos(seen) + np.cos(3 * seen + 1), speed * (times + delay), times)
    >>> round(delay_between_camera_and_stage(turn(0.35, 0.02), turn(-0.35, 0.02)).value, 6)
    0.02
    """
    difference = second.speed_rad_s - first.speed_rad_s
    if abs(difference) < 0.2 * abs(first.speed_rad_s):
        raise InputError(
            "recordings", f"turn at {np.degrees(first.speed_rad_s):.2f} and {np.degrees(second.speed_rad_s):.2f} deg/s",
            accepted="speeds that differ by a fifth at least", remedy="record one at half the speed",
        )  # fmt: skip
    angle, uncertainty = _angle_between(first, second)
    return Found(angle / difference, uncertainty / abs(difference))


def delay_of_flashes(times_s: FloatArray, brightness: FloatArray, exposure_s: float, flashes: FloatArray) -> Found:
    """Return by how much flashes are seen later than they were shown; s.

    A frame's brightness is that of the dark, and more by the share of its exposure in which there was light.

    Parameters
    ----------
    times_s, brightness
        (frame,) time stamps, and means of the frames.
    exposure_s
        Of a frame, about its time stamp.
    flashes
        (flash, 2) when light was turned on and off, by the projector.

    Raises
    ------
    InputError
        There are too few flashes, or the frames do not show them.

    Examples
    --------
    >>> times, flashes = np.arange(0, 8, 0.1), np.array([[1.03, 1.53], [3.27, 3.77], [5.81, 6.31]])
    >>> shares = np.clip((0.02 + 0.25 - np.abs(times[:, None] - flashes.mean(axis=1) - 0.04)) / 0.04, 0, 1)
    >>> round(delay_of_flashes(times, 10 + 50 * shares.sum(axis=1), 0.04, flashes).value, 4)
    0.04
    """
    if len(flashes) < _LEAST_FLASHES:
        raise InputError("flashes", f"are {len(flashes)}", accepted=f"{_LEAST_FLASHES} at least")

    longest = float(np.diff(flashes, axis=1).min())
    tried = np.arange(-longest, longest, _STEP_S)
    misfit = np.array([_misfit(_lit_shares(times_s, exposure_s, flashes + delay), brightness) for delay in tried])
    spread = float(np.square(brightness - brightness.mean()).sum())
    # Where no edge of light falls into an exposure, a range of delays fits alike: the mean over all, by how they fit.
    variance = max(float(misfit.min()) / max(len(times_s) - 3, 1), 1e-9 * spread)
    weights = np.exp(-(misfit - misfit.min()) / (2 * variance))
    delay = float(np.average(tried, weights=weights))
    uncertainty = float(np.sqrt(np.average((tried - delay) ** 2, weights=weights) + _STEP_S**2 / 12))
    if misfit.min() > spread / 2 or uncertainty > longest / 4:
        raise InputError("flashes", "are not seen in the frames", remedy="let the camera see the projector's light")
    return Found(delay, uncertainty)


def _angle_between(first: Turn, second: Turn) -> Found:
    """Return by how much the second turn's angles are larger for the same views, by all waves of the views at once."""
    before, after = _waves(first), _waves(second)
    last = min(len(before), len(after))
    before, after, order = before[:last], after[:last], np.arange(1, last + 1)
    cross = before.conj() * after
    spectrum = np.zeros(_GRID // 2 + 1, complex)
    spectrum[1 : last + 1] = cross.sum(axis=1)
    start, width = TURN_RAD * float(np.argmax(np.fft.irfft(spectrum, _GRID))) / _GRID, TURN_RAD / _GRID

    def likeness(angle: float) -> FloatArray:
        return np.asarray((spectrum[1 : last + 1] * np.exp(1j * order * angle)).real, dtype=np.float64)

    angle = float(minimize_scalar(lambda angle: -likeness(angle).sum(), bounds=(start - width, start + width),
                                  method="bounded", options={"xatol": 1e-9}).x)  # fmt: skip
    by_chance = float(np.linalg.norm(before) * np.linalg.norm(after) / np.sqrt(2 * before.size))
    if likeness(angle).sum() < _LEAST_LIKENESS * by_chance:
        raise InputError(
            "recordings", "look alike from all sides, or show different things",
            remedy="record one thing twice, and one that is not round",
        )  # fmt: skip
    left = np.abs(after - before * np.exp(-1j * order * angle)[:, None]) ** 2
    steepness = float((order**2 * likeness(angle)).sum())
    return Found((angle + np.pi) % TURN_RAD - np.pi, float(np.sqrt(left.mean() / 2 / steepness)))


def _waves(turn: Turn) -> Any:
    """Return (order, value) Fourier coefficients of the views over the angle, without their mean."""
    angles = np.unwrap(turn.angles_rad)
    turned = np.abs(angles - angles[0])
    if turned.max() < TURN_RAD * 0.97:
        raise InputError("recordings", f"hold {np.degrees(turned.max()):.0f} deg", accepted="a full turn")
    within = turned < TURN_RAD * (1 - 1e-9)
    at = np.mod(angles[within], TURN_RAD)
    order = np.argsort(at)
    at, order_kept = np.unique(at[order], return_index=True)
    images = turn.images[within][order][order_kept]
    closed = CubicSpline(np.append(at, at[0] + TURN_RAD), np.concatenate([images, images[:1]]), bc_type="periodic")
    grid = np.arange(_GRID) * TURN_RAD / _GRID
    last = int(_TRUSTED * len(at) / 2)
    return np.fft.rfft(closed(at[0] + np.mod(grid - at[0], TURN_RAD)), axis=0)[1 : last + 1] / _GRID


def _lit_shares(times_s: FloatArray, exposure_s: float, flashes: FloatArray) -> FloatArray:
    begin, end = times_s[:, None] - exposure_s / 2, times_s[:, None] + exposure_s / 2
    lit = np.minimum(end, flashes[:, 1]) - np.maximum(begin, flashes[:, 0])
    return np.asarray(np.maximum(lit, 0.0).sum(axis=1) / exposure_s, dtype=np.float64)


def _misfit(shares: FloatArray, brightness: FloatArray) -> float:
    model = np.stack([np.ones_like(shares), shares], axis=1)
    coefficients = np.linalg.lstsq(model, brightness, rcond=None)[0]
    return float(np.square(brightness - model @ coefficients).sum())
