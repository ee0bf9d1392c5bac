"""A camera's own time and count, brought to the print's clock and to numbers that tell what was lost."""

from __future__ import annotations

import itertools
from collections import deque

_BLOCK_S = 0.5
"""Of each such time the frame that came quickest is kept: the others say more of the transport than of the clocks."""
_BLOCKS = 120
"""Kept: a minute, over which a camera's oscillator drifts evenly."""
_JUMP_S = 0.1
"""A timestamp that is off by more than this, in a way that no delay explains, was set."""
_SHORT_ID = 65535
"""Ids of GigE Vision 1.x go from 1 to this."""


class DeviceTime:
    """Maps a camera's timestamps to the print's clock.

    A frame arrives later than its timestamp by a delay that varies, but never by less than what transport needs.  So of
    the points (timestamp, arrival) the line is sought that lies below all of them and, of such lines, the nearest
    on average: jitter only adds, and does not enter.  That line runs along an edge of the points' lower hull.

    Parameters
    ----------
    largest_drift
        By which share the two clocks may differ in speed.

    References
    ----------
    S. Moon, P. Skelly, D. Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM
    1999.

    Examples
    --------
    >>> clock = DeviceTime()
    >>> times = [clock.to_clock(0.1 * k, 5.0 + 0.1 * k + (0.02 if k % 3 else 0.0)) for k in range(30)]
    >>> round(times[29], 6)
    7.9
    """

    def __init__(self, largest_drift: float = 2e-4) -> None:
        self.jumps = 0
        self._largest_drift = largest_drift
        self._forget()

    def _forget(self) -> None:
        self._quickest: deque[tuple[float, float]] = deque(maxlen=_BLOCKS)
        self._block_ends_s = float("-inf")
        self._origin_s = 0.0
        self._last: float | None = None

    def to_clock(self, stamp_s: float, arrival_s: float, step_s: float | None = None) -> float:
        """Take a frame and return its time by the print's clock.

        Parameters
        ----------
        stamp_s
            By the camera.
        arrival_s
            By the print's clock.
        step_s
            By how much the stamp has grown at least since the last frame, where that is known.

        Notes
        -----
        A stamp that has grown by less, or that lies beyond its own arrival, was set anew; so the relation of the
        clocks is forgotten.  A frame that only arrives late changes nothing.
        """
        if self._has_jumped(stamp_s, arrival_s, step_s):
            self.jumps += 1
            self._forget()
        if self._last is None:
            self._origin_s = self._last = stamp_s
        at = stamp_s - self._origin_s  # small numbers: stamps in nanoseconds since 1970 would round
        if stamp_s >= self._last:
            self._last = stamp_s
            self._keep(at, arrival_s - at)
        return at + self._offset(at)

    def _offset(self, at: float) -> float:
        """Return by how much the print's clock is ahead at a time of the camera's."""
        slope, offset = _line_below(list(self._quickest), self._largest_drift)
        return offset + slope * at

    def _has_jumped(self, stamp_s: float, arrival_s: float, step_s: float | None) -> bool:
        if self._last is None:
            return False
        grown = stamp_s - self._last
        if step_s is None:
            grew_too_little = grown <= 0
        else:
            grew_too_little = grown <= 0 < step_s or step_s - grown > _JUMP_S + 0.05 * abs(step_s)
        at = stamp_s - self._origin_s
        return grew_too_little or arrival_s < at + self._offset(at) - _JUMP_S

    def _keep(self, at: float, delay: float) -> None:
        if at >= self._block_ends_s:
            self._quickest.append((at, delay))
            self._block_ends_s = at + _BLOCK_S
        elif delay < self._quickest[-1][1]:
            self._quickest[-1] = (at, delay)


def _line_below(points: list[tuple[float, float]], steepest: float) -> tuple[float, float]:
    """Return slope and offset of the line that lies below all points and nearest to them on average.

    `points` rise in x.  The mean distance is that at their mean x, so the line is the hull's edge over that place; it
    grows with the slope's distance from that edge's, so a slope that is too steep is cut.
    """
    hull: list[tuple[float, float]] = []
    for x, y in points:
        while len(hull) > 1 and (hull[-1][1] - hull[-2][1]) * (x - hull[-2][0]) >= (y - hull[-2][1]) * (
            hull[-1][0] - hull[-2][0]
        ):
            hull.pop()
        hull.append((x, y))
    if len(hull) < 2:
        return 0.0, hull[0][1]
    middle = sum(x for x, _ in points) / len(points)
    (x0, y0), (x1, y1) = next((a, b) for a, b in itertools.pairwise(hull) if b[0] >= middle)
    slope = min(max((y1 - y0) / (x1 - x0), -steepest), steepest)
    return slope, min(y - slope * x for x, y in hull)


class FrameNumbers:
    """Counts frames from 0 by their ids, so that a lost frame leaves its number out.

    Examples
    --------
    >>> numbers = FrameNumbers()
    >>> [numbers.next(frame_id, 0.0) for frame_id in (65533, 65534, 65535, 1, 3)]
    [0, 1, 2, 3, 5]
    """

    def __init__(self) -> None:
        self._last: tuple[int | None, int] | None = None

    def next(self, frame_id: int | None, periods: float) -> int:
        """Return a frame's number.

        Parameters
        ----------
        frame_id
            The camera's; None where it has none.
        periods
            Frame periods since the last frame: counts where there is no id, and after `restart`.
        """
        number = 0 if self._last is None else self._last[1] + self._step(frame_id, periods)
        if self._last is None or number > self._last[1]:
            self._last = (frame_id, number)
        return number

    def restart(self) -> None:
        """Forget the ids, not the numbers: the camera may begin anew."""
        if self._last is not None:
            self._last = (None, self._last[1])

    def _step(self, frame_id: int | None, periods: float) -> int:
        assert self._last is not None
        last_id = self._last[0]
        by_time = max(1, round(periods))
        if frame_id is None or last_id is None:
            return by_time
        step = frame_id - last_id
        if step == 0 and by_time == round(periods):
            return by_time  # an id that stands still is none
        if max(frame_id, last_id) <= _SHORT_ID and step < -_SHORT_ID // 2:
            step += _SHORT_ID
        # Far behind: the camera has begun anew.  A little behind: out of order.
        return step if step > -_SHORT_ID // 2 else by_time
