"""What a camera, a stage and a projector must do; everything that prints is written against these contracts.

All times are on one `Clock`.  No call waits longer than it says: a device that is silent raises `DeviceTimeoutError`,
one that is broken `DeviceError`.  Devices are driven from one thread each, and are closed once, from any state.
"""

from __future__ import annotations

from enum import IntEnum
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import VialightError


class DeviceError(VialightError):
    """A device does not do what it is there for.

    Parameters
    ----------
    device
        Which one.
    what
        What is wrong, with the value.
    remedy
        What to do about it.
    """

    def __init__(self, device: str, what: str, remedy: str = "") -> None:
        super().__init__(f"{device}: {what}" + (f"; {remedy}" if remedy else ""))


class DeviceTimeoutError(DeviceError):
    """A device has not answered in time; it may yet come back."""


class DeviceLostError(DeviceTimeoutError):
    """The link to a device is lost, for a reason that is known; its driver looks for it."""


class DeviceGoneError(DeviceError):
    """A device will not come back in this print."""


class Clock(Protocol):
    """The print's only source of time: monotonic, the same in every process."""

    def now_s(self) -> float:
        """Return the time."""
        ...

    @property
    def rate(self) -> float:
        """Seconds of this clock in a second of the wall clock: 1 for hardware."""
        ...


class CameraFrame(NamedTuple):
    """What a camera hands over."""

    counts: NDArray[np.uint16]
    """(row, column)."""
    time_s: float
    """Of the middle of the exposure, on the print's clock."""
    number: int
    """The camera's own count, from 0: a number that is left out is a frame that was lost."""


class Camera(Protocol):
    """Grabs frames by itself once started, and keeps at least two seconds of them until they are asked for."""

    @property
    def image_shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        ...

    @property
    def full_level(self) -> int:
        """Counts at which a pixel is saturated."""
        ...

    def start(self, frame_rate_hz: float) -> None:
        """Begin to grab; numbers begin at 0."""
        ...

    def next_frame(self, timeout_s: float) -> CameraFrame:
        """Return the oldest frame not yet handed over; `DeviceTimeoutError` after `timeout_s` of the wall clock."""
        ...

    def close(self) -> None:
        """Stop and let go of the camera."""
        ...


class StagePosition(NamedTuple):
    """Where the stage was, and when."""

    angle_rad: float
    """As the stage counts, over many turns."""
    time_s: float
    """On the print's clock."""


class Stage(Protocol):
    """Turns the vial."""

    def start(self, speed_rad_s: float) -> None:
        """Turn from now on, ever on, at this speed; does not wait until it is reached."""
        ...

    def position(self, timeout_s: float) -> StagePosition:
        """Return where the stage is; `DeviceTimeoutError` after `timeout_s` of the wall clock."""
        ...

    def stop(self) -> None:
        """Come to rest."""
        ...

    def close(self) -> None:
        """Stop and let go of the stage."""
        ...


class LightPhase(IntEnum):
    """How far a print's light is.  Dark and lit may take turns; what comes after them never goes back."""

    DARK = 0
    LIT = 1
    OVER = 2
    """Black for good: nothing lights any more in this print."""
    CLOSED = 3
    """And the projector is let go."""


class Lease(NamedTuple):
    """Leave to show light, for a fraction of a second: it must be renewed, or the projector goes black by itself."""

    phase: LightPhase
    """Light is shown in the phase LIT only; OVER cannot be renewed."""
    until_monotonic_s: float
    """End of the lease, by `time.monotonic`: whatever happens to whoever gave it."""
    angle_rad: float
    """Of the object, counter-clockwise seen from above, at `time_s`."""
    time_s: float
    """On the print's clock."""
    speed_rad_s: float
    """At which the object turns, counter-clockwise positive."""
    off_at_s: float
    """When the print ends, on the print's clock; black from then on."""

    @classmethod
    def none(cls, phase: LightPhase, now_monotonic_s: float) -> Lease:
        """Return what says that there is no leave from now on."""
        return cls(phase, now_monotonic_s, 0.0, 0.0, 0.0, 0.0)


class Shown(NamedTuple):
    """What the projector shows."""

    pattern: int | None
    """None is black."""
    since_s: float
    """On the print's clock."""


class Projector(Protocol):
    """Shows the pattern that is due, by itself, in a process of its own, while it has a lease.

    Black is what it shows before the first lease, when a lease has run out, when its process or the one that gives
    leases has ended, and when anything goes wrong.
    """

    def renew(self, lease: Lease) -> None:
        """Replace the lease; never waits."""
        ...

    def darken(self) -> None:
        """Withdraw the lease: black at the next refresh; never waits."""
        ...

    def end(self) -> None:
        """Withdraw the lease for good: black at the next refresh, whatever is asked for later; never waits."""
        ...

    def shown(self) -> Shown:
        """Return what is on the screen now; `DeviceError` where projector or guardian is not well.

        Where one of their processes has ended, that is a `DeviceGoneError`.
        """
        ...

    def close(self) -> None:
        """Black, and let go of the screen."""
        ...


class Devices(NamedTuple):
    """What a print is made with."""

    clock: Clock
    camera: Camera
    stage: Stage
    projector: Projector
