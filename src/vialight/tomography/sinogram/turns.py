"""Which frames make a turn, and whether their angles support an answer."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import TURN_RAD, FloatArray, IntArray
from vialight.core.errors import InputError

WIDEST_GAP_RAD = np.radians(30.0)
"""Across more than this the opposite views, which tilt the other way, would stand alone for too much of the volume."""

_SAME_ANGLE_RAD = 1e-6

_WRAPPED_RAD = 1.25 * TURN_RAD
"""Angles that span more than this count turns; others may begin anew with each."""

_SHUFFLED_SHARE = 0.1
"""A stage turns one way: if more of the steps than this are wide ones against it, frames are not in order."""

_SHORT_END_STEPS, _SHORT_END_RAD = 3, np.radians(15.0)
"""A turn is full though it ends this much early: frames may be missing there as anywhere."""


def select_turn(angles_rad: FloatArray, turn: int | None = None) -> IntArray:
    """Return the frames of one turn.

    Parameters
    ----------
    angles_rad
        (frame,) stage angles, rising or falling, cumulative or wrapped at a full turn; in any order if cumulative.
    turn
        1 is the turn that begins with the first angle; None the one that ends with the last frame, since a print may
        have grown until then, or all frames if they are less than a turn.

    Returns
    -------
    numpy.ndarray
        Indices of frames, in the order of recording.

    Raises
    ------
    InputError
        There is no such turn, or which turn frames belong to cannot be known.
    """
    travelled = _travelled(angles_rad)
    step = nominal_step(np.sort(travelled))
    if turn is None:
        return np.asarray(np.flatnonzero(travelled > travelled.max() + step / 2 - TURN_RAD), dtype=np.int64)
    turns = _full_turns(travelled, step)
    if not 1 <= turn <= max(turns, 1):
        degrees = np.degrees(travelled.max())
        raise InputError("--turn", f"is {turn}, the frames span {degrees:.1f} deg", accepted=f"1 to {max(turns, 1)}")
    start = (turn - 1) * TURN_RAD - step / 2
    chosen = np.flatnonzero((travelled >= start) & (travelled < start + TURN_RAD))
    return np.asarray(chosen, dtype=np.int64)


def count_turns(angles_rad: FloatArray) -> int:
    """Return how many full turns frames make; the arguments are those of `select_turn`.

    Examples
    --------
    >>> count_turns(np.radians(np.arange(400) * 2.0))
    2
    """
    travelled = _travelled(angles_rad)
    return _full_turns(travelled, nominal_step(np.sort(travelled)))


def _full_turns(travelled: FloatArray, step: float) -> int:
    end = travelled.max() + max(step, min(_SHORT_END_STEPS * step, _SHORT_END_RAD))
    return int(end / TURN_RAD + 1e-6)


def _travelled(angles_rad: FloatArray) -> FloatArray:
    """Return how far the stage had turned since its first angle, at every frame."""
    if np.ptp(angles_rad) > _WRAPPED_RAD:
        order = np.arange(len(angles_rad)) - (len(angles_rad) - 1) / 2
        falls = order @ (angles_rad - angles_rad.mean()) < 0
        return np.asarray(angles_rad.max() - angles_rad if falls else angles_rad - angles_rad.min())
    steps = np.diff(np.unwrap(angles_rad))
    wide = np.abs(steps) > TURN_RAD / 8
    against = min((wide & (steps > 0)).sum(), (wide & (steps < 0)).sum())
    if against > _SHUFFLED_SHARE * len(steps):
        raise InputError(
            "/exchange/theta", f"angles go back and forth in {against} of {len(steps)} steps",
            accepted="frames in order of recording, or angles that count on beyond 360 deg", remedy="sort the frames",
        )  # fmt: skip
    return np.asarray(np.abs(np.unwrap(angles_rad) - angles_rad[0]), dtype=np.float64)


def nominal_step(angles_rad: FloatArray) -> float:
    """Return the median step between neighbouring, different angles."""
    steps = np.abs(np.diff(angles_rad))
    steps = steps[steps > 1e-9]
    if not len(steps):
        raise InputError("/exchange/theta", "all angles are the same", accepted="angles of a turning object")
    return float(np.median(steps))


def frames_a_turn(angles_rad: FloatArray) -> int:
    """Return the even number of frames that makes a turn, from the median step.

    Examples
    --------
    >>> frames_a_turn(np.radians(np.arange(400) * 2.0))
    180

    Raises
    ------
    InputError
        The stage does not turn, or too fast for its frames.
    """
    step = nominal_step(np.unwrap(angles_rad)) if len(angles_rad) > 1 else 0.0
    if not 0 < step < TURN_RAD / 4:
        raise InputError("/exchange/theta", f"steps of {np.degrees(step):.3g} deg", accepted="a turning stage")
    return max(4, 2 * round(TURN_RAD / 2 / step))


def sorted_turn(angles_rad: FloatArray) -> tuple[IntArray, FloatArray]:
    """Sort frames by angle within the turn; of frames at one angle the last stays."""
    wrapped = np.mod(angles_rad, TURN_RAD)
    wrapped[wrapped > TURN_RAD - _SAME_ANGLE_RAD] = 0.0
    order = np.argsort(wrapped, kind="stable")
    apart = np.diff(wrapped[order], append=np.inf) > _SAME_ANGLE_RAD
    order = order[apart]
    return np.asarray(order, dtype=np.int64), wrapped[order]


def widest_gap(angles: FloatArray) -> tuple[float, float]:
    """Return where the widest gap between sorted angles of a turn begins, and its width."""
    gaps = np.diff(angles, append=angles[0] + TURN_RAD)
    widest = int(gaps.argmax())
    return float(angles[widest]), float(gaps[widest])


def check_gaps(angles: FloatArray, half_turn_suffices: bool) -> None:
    """Refuse a turn in which frames are missing over too wide an angle."""
    start_rad, gap_rad = widest_gap(angles)
    start, gap = np.degrees(start_rad), np.degrees(gap_rad)
    # Parallel rays are the same from both sides: half a turn is enough.
    if half_turn_suffices and gap <= 180 + 2 * np.degrees(nominal_step(angles)):
        return
    if gap_rad > WIDEST_GAP_RAD + _SAME_ANGLE_RAD:
        raise InputError(
            "/exchange/theta", f"no frames for {gap:.1f} deg after {start:.1f} deg",
            accepted=f"gaps of up to {np.degrees(WIDEST_GAP_RAD):.0f} deg in a turn"
            if not half_turn_suffices else "half a turn or more",
            remedy="choose another --turn, or record a full turn",
        )  # fmt: skip
