"""Show patterns one after the other while the stage turns once, and keep the frames that each was seen in alone."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD
from vialight.devices import LEASE_S, CameraFrame, DeviceError, Devices, DeviceTimeoutError, Lease, LightPhase, Shown

DARK_FRAMES = 8
SETTLED_S = 0.1
"""After and before a change of pattern, frames may show both."""
_BEAT_S = 0.025
_SILENT_S = 2.0
_STAGE_TIMEOUT_S = 0.08


@dataclass(frozen=True)
class SweepFrames:
    """What a sweep recorded.

    Parameters
    ----------
    counts
        (frame, row, column).
    pattern
        (frame,) which was shown.
    dark
        (frame, row, column) before any light.
    """

    counts: NDArray[np.uint16]
    pattern: NDArray[np.int64]
    dark: NDArray[np.uint16]


def record_sweep(
    devices: Devices, *, direction: int, speed_rad_s: float, frame_rate_hz: float = 10.0,
    keep_going: Callable[[], bool] = lambda: True,
) -> SweepFrames:  # fmt: skip
    """Let a projector show its patterns over one turn of the stage.

    Parameters
    ----------
    devices
        Whose projector has patterns for all of a turn.
    direction
        1 where the stage counts counter-clockwise seen from above, else -1.
    speed_rad_s, frame_rate_hz
        Of stage and camera.
    keep_going
        Asked all the time; False ends the sweep, the light first.

    Raises
    ------
    DeviceError
        The camera is silent, the stage does not answer, no pattern was seen alone, or the sweep was ended.
    """
    frames: list[CameraFrame] = []
    changes: list[Shown] = []
    try:
        devices.camera.start(frame_rate_hz)
        devices.stage.start(speed_rad_s)
        dark = [devices.camera.next_frame(_SILENT_S).counts for _ in range(DARK_FRAMES)]
        # A little more than a turn: the stage has just begun to move.
        ends_s = devices.clock.now_s() + 1.1 * TURN_RAD / speed_rad_s
        answered_s = devices.clock.now_s()
        while devices.clock.now_s() < ends_s and keep_going():
            answered_s = _renew(devices, direction, speed_rad_s, ends_s, answered_s)
            shown = devices.projector.shown()
            if not changes or shown.pattern != changes[-1].pattern:
                changes.append(shown)
            frames += _newest(devices, frames)
    finally:
        devices.projector.darken()
        devices.stage.stop()
    if not keep_going():
        raise DeviceError("sweep", "was ended before its time")
    return _sorted(frames, changes, np.stack(dark), ends_s)


def _renew(devices: Devices, direction: int, speed_rad_s: float, ends_s: float, answered_s: float) -> float:
    """Renew the lease, and return when the stage answered; while it does not, the light goes off with the lease."""
    try:
        position = devices.stage.position(_STAGE_TIMEOUT_S)
    except DeviceTimeoutError:
        if devices.clock.now_s() - answered_s > _SILENT_S * devices.clock.rate:
            raise
        return answered_s
    devices.projector.renew(
        Lease(
            LightPhase.LIT, time.monotonic() + LEASE_S, direction * position.angle_rad, position.time_s,
            direction * speed_rad_s, ends_s,
        )
    )  # fmt: skip
    return position.time_s


def _newest(devices: Devices, frames: list[CameraFrame]) -> list[CameraFrame]:
    """Wait for a frame no longer than a lease allows; no frame at all for long is a fault."""
    try:
        return [devices.camera.next_frame(_BEAT_S)]
    except DeviceTimeoutError:
        silent_s = devices.clock.now_s() - frames[-1].time_s if frames else 0.0
        if silent_s > _SILENT_S * devices.clock.rate:
            raise
        return []


def _sorted(frames: list[CameraFrame], changes: list[Shown], dark: NDArray[np.uint16], ends_s: float) -> SweepFrames:
    times = np.array([frame.time_s for frame in frames])
    bounds = np.array([change.since_s for change in changes] + [ends_s])
    # A frame before the first change has no pattern, one after the end neither.
    place = np.clip(np.searchsorted(bounds, times) - 1, 0, len(changes) - 1)
    alone = (times > bounds[place] + SETTLED_S) & (times < bounds[place + 1] - SETTLED_S)
    kept = [k for k in np.flatnonzero(alone) if changes[place[k]].pattern is not None]
    if not kept:
        raise DeviceError("sweep", f"of {len(frames)} frames none shows one pattern alone", "turn more slowly")
    pattern = [changes[place[k]].pattern for k in kept]
    return SweepFrames(np.stack([frames[k].counts for k in kept]), np.array(pattern, dtype=np.int64), dark)
