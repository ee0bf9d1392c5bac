"""Where the stage is at any moment, from positions that it has told."""

from __future__ import annotations

import threading
import time
from collections import deque

import numpy as np

from vialight.devices import DeviceError, DeviceTimeoutError, Stage, StagePosition

_KEPT = 400
_ASK_S, _ANSWER_S = 0.025, 0.2
_SPEED_OVER_S = 0.12
"""Speed is that of the positions over this time: short enough to see a stall, long enough for an encoder's steps."""
_WAIT_S = 0.3
"""By the wall clock, after a position came, for the next one, which a frame waits for."""
LONGEST_GAP_S = 0.5
"""By the wall clock: a stage that was not heard for longer may have stalled and caught up meanwhile."""
BEYOND_S = 0.02
"""On the print's clock, before the first position and after the last: a stage that stalls is 0.4 deg behind by then."""


class StageTrack:
    """Positions of the stage, one thread adding, others asking.

    Parameters
    ----------
    longest_gap_s
        On the print's clock: where the stage was not heard for longer, its motion between is not known.

    Examples
    --------
    >>> track = StageTrack()
    >>> for k in range(5):
    ...     track.add(StagePosition(0.1 * k, 0.1 * k))
    >>> round(track.angle_at(0.25), 3), track.angle_at(0.6), round(track.speed_rad_s(), 3)
    (0.25, nan, 1.0)
    """

    def __init__(self, longest_gap_s: float = LONGEST_GAP_S) -> None:
        self._longest_gap_s = longest_gap_s
        self._positions: deque[StagePosition] = deque(maxlen=_KEPT)
        self._came_s = float("-inf")
        self._lock = threading.Condition()

    def add(self, position: StagePosition) -> None:
        """Take a position; one that is not newer than the last is left out."""
        with self._lock:
            if not self._positions or position.time_s > self._positions[-1].time_s:
                self._positions.append(position)
                self._came_s = time.monotonic()
                self._lock.notify_all()

    def newest(self) -> StagePosition | None:
        """Return the last position; None before the first."""
        with self._lock:
            return self._positions[-1] if self._positions else None

    def angle_at(self, time_s: float) -> float:
        """Return the angle at a time: between positions by a straight line; rad.

        Between positions that lie too far apart it is not known: NaN.
        Up to `BEYOND_S` beyond them it goes on at the speed there; still further, it is not known: NaN.
        """
        with self._lock:
            times, angles = self._arrays()
        if len(times) < 2 or not times[0] - BEYOND_S <= time_s <= times[-1] + BEYOND_S:
            return float("nan")
        if time_s < times[0]:
            return float(angles[0] + (angles[1] - angles[0]) / (times[1] - times[0]) * (time_s - times[0]))
        if time_s > times[-1]:
            return float(angles[-1] + self.speed_rad_s() * (time_s - times[-1]))
        after = int(np.searchsorted(times, time_s))
        if after and times[after] - times[after - 1] > self._longest_gap_s:
            return float("nan")
        return float(np.interp(time_s, times, angles))

    def settled_angle_at(self, time_s: float) -> float:
        """Return the angle at a time just past, once the stage has told a position after it; rad, or NaN.

        A frame comes before the stage is asked again.  Beyond the last position its angle would hang on the speed,
        which is known the worse the more the times of positions jitter.  A stage that has been silent for a while is
        not waited for.
        """
        with self._lock:
            while self._positions and self._positions[-1].time_s < time_s:
                left_s = self._came_s + _WAIT_S - time.monotonic()
                if left_s <= 0:
                    break
                self._lock.wait(left_s)
        return self.angle_at(time_s)

    def turned_rad(self, begin_s: float, end_s: float) -> float:
        """Return by how much the stage turned between two times, rad.

        After the last position it is taken to go on at its last speed: good enough to count turns of light, not to
        tell a frame's angle.
        """
        with self._lock:
            times, angles = self._arrays()
        if len(times) < 2:
            return 0.0
        bounds = np.array([begin_s, end_s])
        beyond = np.maximum(0.0, bounds - times[-1]) * self.speed_rad_s()
        return abs(float(np.diff(np.interp(bounds, times, angles) + beyond)[0]))

    def speed_rad_s(self) -> float:
        """Return the speed over the last tenth of a second; NaN before there are two positions."""
        with self._lock:
            times, angles = self._arrays()
        if len(times) < 2:
            return float("nan")
        first = min(int(np.searchsorted(times, times[-1] - _SPEED_OVER_S)), len(times) - 2)
        return float((angles[-1] - angles[first]) / (times[-1] - times[first]))

    def _arrays(
        self,
    ) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], np.ndarray[tuple[int], np.dtype[np.float64]]]:
        positions = np.array(self._positions, dtype=np.float64).reshape(-1, 2)
        return positions[:, 1], positions[:, 0]


class StageFollower:
    """Asks a stage where it is, on a thread of its own, where no light is at stake.

    Parameters
    ----------
    stage
        Who is asked.
    track
        Takes the answers.
    """

    def __init__(self, stage: Stage, track: StageTrack) -> None:
        self._stage, self._track = stage, track
        self._ending = threading.Event()
        self._answered_s = time.monotonic()
        self._told = ""
        self._thread = threading.Thread(target=self._run, name="stage", daemon=True)
        self._thread.start()

    def fault(self, patience_s: float) -> str | None:
        """Say what is wrong with the stage, where that has lasted; None while it answers."""
        is_silent = time.monotonic() - self._answered_s > patience_s
        return (self._told or "does not answer") if is_silent else None

    def close(self) -> None:
        """Ask no more."""
        self._ending.set()
        self._thread.join(2.0)

    def _run(self) -> None:
        while not self._ending.wait(_ASK_S):
            try:
                self._track.add(self._stage.position(_ANSWER_S))
                self._answered_s = time.monotonic()
            except DeviceTimeoutError as error:
                self._told = str(error)
            except DeviceError as error:
                self._told, self._answered_s = str(error), float("-inf")
                return
            except Exception as error:
                self._told, self._answered_s = f"its driver has failed: {error!r}", float("-inf")
                raise
