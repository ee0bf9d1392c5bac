"""When a virtual angle is brought into the volume.

A frame adds a few columns each to all virtual angles within the skew, up to 42 deg either side: to bring all of them
in with every frame would cost forty times what it costs to bring one in.  So an angle waits until the stage has passed
it by some lag, and again by the next: on the axis, where its middle columns have come; further on, where the columns of
the inner half of the field have come on the side that comes late; and when its last column has come, for good.  That is
three angles a frame.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD, BoolArray, FloatArray, IntArray

_FIELD_SHARES = (0.0, 0.5, 1.0)
"""Out to which share of the field columns have come on the late side when an angle is brought in."""

_CUBIC_STEPS = 1.5
"""After its last column an angle waits for the frame after the next, with which interpolation becomes cubic."""

_ROUNDING_RAD = 1e-6
"""Where frames and virtual angles coincide, rounding shall not decide with which frame an angle is due."""

_AHEAD_STEPS = 4
"""A frame also changes, a little, rays of the older turn that lie up to two frames ahead of it."""

_LATE_ROWS = 1
"""Angles a frame that are brought in once more because a frame came late."""


class Schedule:
    """Which virtual angles are due.

    Parameters
    ----------
    psi_rad
        (psi,) virtual angles of a turn.
    directions_rad
        (x_v,) gamma of the rays; NaN where none is seen.
    step_rad
        Between frames.
    """

    def __init__(self, psi_rad: FloatArray, directions_rad: FloatArray, step_rad: float) -> None:
        skew = np.sort(np.abs(directions_rad[np.isfinite(directions_rad)]))
        lags = [float(skew[int(share * (len(skew) - 1))]) for share in _FIELD_SHARES]
        lags[-1] += _CUBIC_STEPS * step_rad
        self.lags_rad = np.array([lag for i, lag in enumerate(lags) if i == 0 or lag > lags[i - 1] + step_rad / 2])
        self.touched = np.zeros(len(psi_rad), np.uint8)
        """(psi,) 1 for angles of which rays have changed since they were brought in."""
        self._psi = psi_rad
        self._skew = float(skew[-1])
        self._ahead = self._skew + _AHEAD_STEPS * step_rad
        self._done = np.zeros(len(psi_rad), np.int64)

    def incomplete(self, newest_rad: float, sense: int) -> BoolArray:
        """Return (psi,) which angles are passing by: some columns are of this turn, others older, or not shown yet."""
        lag = self._lag(newest_rad, sense)
        return np.asarray(((lag > -self._skew) & (lag < self.lags_rad[-1])) | (self.touched > 0))

    def take_due(self, newest_rad: float, sense: int, frames: int) -> IntArray:
        """Return the angles of the first half turn that are due, and count them as done.

        Parameters
        ----------
        newest_rad
            Angle of the newest frame.
        sense
            1 where the object's angle grows, -1 where it falls.
        frames
            How many have come since the last time.
        """
        lag = self._lag(newest_rad, sense)
        reached = np.searchsorted(self.lags_rad - _ROUNDING_RAD, lag, side="right")
        due = (self.touched > 0) & (reached > self._done)
        late = np.flatnonzero((self.touched > 0) & ~due & (reached == len(self.lags_rad)))
        due[late[np.argsort(-lag[late])][: frames * _LATE_ROWS]] = True
        self._done = reached
        return self._take(due)

    def take_all(self) -> IntArray:
        """Return all angles of the first half turn that have changed, and count them as done."""
        return self._take(self.touched > 0)

    def _take(self, chosen: NDArray[np.bool_]) -> IntArray:
        half = len(chosen) // 2
        # An angle and its opposite are one row of the folded sinogram.
        rows = np.flatnonzero(chosen[:half] | chosen[half:])
        self.touched[rows] = self.touched[rows + half] = 0
        return rows

    def _lag(self, newest_rad: float, sense: int) -> FloatArray:
        """Return how far the stage has gone past each angle, negative before that: within a turn that ends ahead."""
        return np.asarray((sense * (newest_rad - self._psi) + self._ahead) % TURN_RAD - self._ahead)
