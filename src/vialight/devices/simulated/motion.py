"""How the simulated stage turns: the same function of time for who asks for its position and for what stands on it."""

from __future__ import annotations

import time

from vialight.devices.protocols import Clock, DeviceTimeoutError, StagePosition
from vialight.devices.simulated.mishaps import Mishaps
from vialight.system import state_of
from vialight.system.mailboxes import Mailbox

SPIN_UP_S = 0.5
"""In which the stage reaches its speed, evenly."""

Segments = tuple[tuple[float, float, float], ...]
"""Time from which, angle there, and speed, of each piece of the motion."""


def angle_at(segments: Segments, time_s: float) -> float:
    """Return the stage's angle; 0 before it first moved.

    Examples
    --------
    >>> round(angle_at(((1.0, 0.0, 0.5), (3.0, 1.0, 0.0)), 2.0), 3), angle_at(((1.0, 0.0, 0.5), (3.0, 1.0, 0.0)), 9.0)
    (0.5, 1.0)
    """
    angle = 0.0
    for start, there, speed in segments:
        if time_s >= start:
            angle = there + speed * (time_s - start)
    return angle


def motion_of(speed_rad_s: float, start_s: float, mishaps: Mishaps) -> Segments:
    """Return the pieces of a motion that begins at a time, in which the mishaps happen."""
    changes = {start_s + SPIN_UP_S * k / 8: (k + 0.5) / 8 for k in range(8)} | {start_s + SPIN_UP_S: 1.0}
    changes[mishaps.stage_slow_at_s] = mishaps.stage_slow_share
    changes[mishaps.stage_stops_at_s] = 0.0
    changes[mishaps.stage_goes_on_at_s] = 1.0
    segments: list[tuple[float, float, float]] = []
    for at, share in sorted(changes.items()):
        if at < float("inf"):
            segments.append((at, angle_at(tuple(segments), at), share * speed_rad_s))
    return tuple(segments)


class SimulatedStage:
    """A stage that turns in step with the simulated resin, to which it tells its motion.

    Parameters
    ----------
    clock
        The print's.
    mailbox
        In which the world finds the motion.
    mishaps
        What is to go wrong.
    world_pid
        Of the process that simulates: while it is held up, so is the stage.
    """

    def __init__(self, clock: Clock, mailbox: Mailbox[Segments], mishaps: Mishaps, world_pid: int) -> None:
        self._clock, self._mailbox, self._mishaps, self._world_pid = clock, mailbox, mishaps, world_pid
        self._segments: Segments = ()

    def start(self, speed_rad_s: float) -> None:
        """Turn from now on."""
        self._segments = motion_of(speed_rad_s, self._clock.now_s(), self._mishaps)
        self._mailbox.put(self._segments)

    def position(self, timeout_s: float) -> StagePosition:
        """Return where the stage is."""
        now = self._clock.now_s()
        if now >= self._mishaps.stage_silent_at_s or state_of(self._world_pid) != "runs":
            time.sleep(timeout_s)
            raise DeviceTimeoutError("stage", f"has not answered within {timeout_s:g} s")
        return StagePosition(angle_at(self._segments, now), now)

    def stop(self) -> None:
        """Come to rest at once."""
        now = self._clock.now_s()
        self._segments = (*self._segments, (now, angle_at(self._segments, now), 0.0))
        self._mailbox.put(self._segments)

    def close(self) -> None:
        """Stop."""
        self.stop()
