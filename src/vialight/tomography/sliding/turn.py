"""The frames of the latest turn, by angle: which stay, which go, and which lie next to a new one."""

from __future__ import annotations

from bisect import bisect_left
from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import TURN_RAD, FloatArray, IntArray

_CLOSEST_STEPS = 1 / 3
"""Frames of one pass that lie closer than this add noise to the polynomial between them, and nothing else."""

_SAME_STEPS = 0.02
"""Frames closer than this show the same: a duplicate, or a stage that stands still.  The last one stays."""

_SEAM_STEPS = 0.5
"""A frame goes once the stage has come closer than this to its angle again."""

_SURE_STEPS = 3
"""The stage's sense is settled once it has gone this far."""

_WRAPPED_RAD = 1.25 * TURN_RAD
"""Angles that span more than this count turns; others may begin anew with each."""


@dataclass(frozen=True)
class Placing:
    """Where a frame belongs.

    Parameters
    ----------
    slot
        Memory for its view.
    angle_rad
        Its angle on the circle.
    offsets_rad, slots
        (7,) angles relative to it, and slots, of three frames before it, itself, and three after it.
    """

    slot: int
    angle_rad: float
    offsets_rad: FloatArray
    slots: IntArray


@dataclass
class _Frame:
    position: float
    """Angle without wrapping."""
    first_position: float
    """Of the first of the frames that have taken each other's place here."""
    slot: int


class LatestTurn:
    """The frames of one turn up to the newest.

    Frames may come late, in any order, twice, and from a stage that turns either way.  Angles may count turns or begin
    anew with each; if they begin anew, no gap may be longer than half a turn.

    Parameters
    ----------
    frames_per_turn
        As many as there are at the stage's usual speed.
    """

    def __init__(self, frames_per_turn: int) -> None:
        self.step_rad = TURN_RAD / frames_per_turn
        self.capacity = int(np.ceil(frames_per_turn / _CLOSEST_STEPS)) + 2
        self.sense = 1
        """1 where the object's angle grows, -1 where it falls."""
        self._angles: list[float] = []  # on the circle, ascending
        self._frames: list[_Frame] = []
        self._free = list(range(self.capacity))[::-1]
        self._heard: tuple[float, float] | None = None  # last angle as given, and without wrapping
        self._first_position = self._newest = 0.0
        self._lowest = self._highest = 0.0
        self._is_sure = False

    def __len__(self) -> int:
        return len(self._frames)

    @property
    def newest_rad(self) -> float:
        """Angle, without wrapping, of the frame that is furthest along."""
        return self._newest

    def place(self, angle_rad: float) -> Placing | None:
        """Find a frame's place, let go what is a turn old, and say what lies about it.

        Returns
        -------
        Placing or None
            None for a frame that is too late, or that shows no more than its neighbour does.
        """
        position = self._unwrap(angle_rad)
        self._settle_sense(position)
        if self._travel(position) > TURN_RAD - _SEAM_STEPS * self.step_rad:
            return None
        on_circle = position % TURN_RAD
        near = self._nearest(on_circle)
        if near is not None and abs(near.position - position) < _CLOSEST_STEPS * self.step_rad:
            if abs(near.first_position - position) > _SAME_STEPS * self.step_rad:
                return None
            self._remove(self._frames.index(near))
            frame = _Frame(position, near.first_position, self._free.pop())
        else:
            frame = _Frame(position, position, self._free.pop())
        if self._travel(position) < 0 or not self._frames:
            self._newest = position
            self._let_go()
        index = bisect_left(self._angles, on_circle)
        self._angles.insert(index, on_circle)
        self._frames.insert(index, frame)
        return self._placing(index)

    def _travel(self, position: float) -> float:
        """Return how far the newest frame is ahead of a position."""
        return self.sense * (self._newest - position)

    def _unwrap(self, angle: float) -> float:
        if self._heard is None:
            self._heard = (angle, angle)
            self._lowest = self._highest = self._first_position = self._newest = angle
            return angle
        change = angle - self._heard[0]
        self._lowest, self._highest = min(self._lowest, angle), max(self._highest, angle)
        if self._highest - self._lowest < _WRAPPED_RAD:
            change = (change + TURN_RAD / 2) % TURN_RAD - TURN_RAD / 2
        self._heard = (angle, self._heard[1] + change)
        return self._heard[1]

    def _settle_sense(self, position: float) -> None:
        if self._is_sure:
            return
        travelled = position - self._first_position
        sense = -1 if travelled < 0 else 1
        if sense != self.sense and self._frames:
            self.sense = sense
            self._newest = sense * max(sense * frame.position for frame in self._frames)
        self._is_sure = abs(travelled) > _SURE_STEPS * self.step_rad

    def _nearest(self, on_circle: float) -> _Frame | None:
        if not self._frames:
            return None
        index = bisect_left(self._angles, on_circle)
        neighbours = (index % len(self), index - 1)

        def distance(i: int) -> float:
            return abs((self._angles[i] - on_circle + TURN_RAD / 2) % TURN_RAD - TURN_RAD / 2)

        return self._frames[min(neighbours, key=distance)]

    def _let_go(self) -> None:
        limit = TURN_RAD - _SEAM_STEPS * self.step_rad
        for index in reversed(range(len(self))):
            if self._travel(self._frames[index].position) > limit:
                self._remove(index)

    def _remove(self, index: int) -> None:
        self._free.append(self._frames.pop(index).slot)
        del self._angles[index]

    def _placing(self, index: int) -> Placing:
        count, here = len(self), self._angles[index]
        near = np.arange(index - 3, index + 4)
        angles = np.array([self._angles[i % count] for i in near]) + near // count * TURN_RAD
        slots = np.array([self._frames[i % count].slot for i in near], dtype=np.int64)
        return Placing(self._frames[index].slot, here, angles - here, slots)
