"""Rotation stages of Physik Instrumente, and others that speak GCS 2, through pipython.

The stage turns by one long move to a far target.  Every closed-loop controller has that command, its profile keeps the
speed, and the move has an end: a stage whose computer is gone does not turn for ever, as one that jogs would.
"""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Iterator
from typing import Any, Self

from vialight.core.config import StageSettings
from vialight.core.errors import InputError
from vialight.devices.protocols import Clock, DeviceError, DeviceTimeoutError, StagePosition
from vialight.devices.stages.link import ADDRESSES, Link

_ANSWER_S = 1.0
"""For an answer while nothing hurries."""
_REFERENCE_S = 120.0
_TRUSTED_S = 0.03
"""Round trip beyond which nobody knows when the stage was there: 0.3 deg either way at 20 deg/s."""
_ERRORS_EVERY_S = 1.0
_FAR_DEG = 360_000.0
"""Of one move: 1000 turns."""
_NEEDED_DEG = 50 * 360.0
"""Of room that a long print needs."""
_POLL_S = 0.05
_STOPPED, _NO_ANSWER, _NONSENSE = 10, -7, -1004
"""Codes of GCS errors: by the controller when it was told to stop, and by pipython."""


class PiStage:
    """A rotation stage behind a GCS 2 controller.

    Parameters
    ----------
    settings
        Where it is, and which axis.
    clock
        The print's.

    Attributes
    ----------
    identity : str
        What the controller calls itself.
    kind : str
        Name of the stage that it is set up for.

    Raises
    ------
    InputError
        The settings name no address, or an axis that the controller has not.
    DeviceError
        It cannot be reached, or pipython is not installed.
    """

    def __init__(self, settings: StageSettings | None, clock: Clock) -> None:
        try:
            from pipython import GCSDevice
            from pipython.pidevice.gcserror import GCSError
        except ImportError as error:
            raise DeviceError(
                "stage", 'driver "pi" needs pipython', "install it: pip install 'vialight[pi]'"
            ) from error
        if settings is None or settings.address is None:
            raise InputError("[stage.settings]", "has no address", accepted=ADDRESSES)
        self._settings, self._clock, self._axis = settings, clock, settings.axis
        self._gcs_error = GCSError
        self._lock = threading.Lock()
        self._fault: DeviceError | None = None
        self._errors_at = 0.0
        self._is_out_of_step = False
        self.identity = self.kind = ""
        self._link = Link(settings.address, clock)
        try:
            with self._talk(_ANSWER_S):
                self._link.flush()
                self._device: Any = GCSDevice(gateway=self._link)
                self._introduce()
        except BaseException:
            self._link.close()
            raise

    def prepared(self) -> Self:
        """Return this stage, referenced and under servo control; it moves where it was not referenced.

        Raises
        ------
        DeviceError
            It does not get ready, or has no room for a print.
        """
        try:
            with self._talk(_ANSWER_S):
                self._device.SVO(self._axis, True)
                if not self._knows_where_it_is() or self._room_deg(1) < _NEEDED_DEG:
                    self._refer()
        except BaseException:
            self.close()
            raise
        return self

    def is_referenced(self) -> bool:
        """Whether the controller knows where the stage is; where it does not, `prepared` moves it."""
        with self._talk(_ANSWER_S):
            return self._knows_where_it_is()

    def start(self, speed_rad_s: float) -> None:
        """Turn from now on, as far as the axis goes."""
        sense = int(math.copysign(1, speed_rad_s))
        with self._talk(_ANSWER_S):
            self._fault = None
            here, room = self._here_deg(), self._room_deg(sense)
            if room < _NEEDED_DEG:
                raise DeviceError(
                    "stage", f"can turn by {room:.0f} deg only from {here:.1f} deg on, a print needs {_NEEDED_DEG:.0f}",
                    "raise its travel limits (parameters 0x15 and 0x30), or reference it anew",
                )  # fmt: skip
            self._device.VEL(self._axis, math.degrees(abs(speed_rad_s)))
            self._device.MOV(self._axis, here + sense * min(room, _FAR_DEG))

    def position(self, timeout_s: float) -> StagePosition:
        """Return where the stage is; the time is the middle of question and answer.

        An answer that took long says little about when the stage was there: it is dropped, and the stage asked again.
        """
        deadline = time.monotonic() + timeout_s
        with self._talk(timeout_s):
            self._look_for_errors()
            while True:
                angle_deg = self._here_deg()
                if (took_s := self._link.answered_s - self._link.asked_s) <= _TRUSTED_S:
                    middle_s = (self._link.asked_s + self._link.answered_s) / 2
                    return StagePosition(math.radians(angle_deg), middle_s - self._settings.latency_s)
                if (left_s := deadline - time.monotonic()) < took_s:
                    raise DeviceTimeoutError("stage", f"takes {took_s:.3f} s to answer, more than {_TRUSTED_S:g}")
                self._link.settimeout(_milliseconds(left_s))

    def stop(self) -> None:
        """Come to rest, smoothly."""
        with self._talk(_ANSWER_S):
            self._device.HLT(self._axis, noraise=True)  # error 10, "stopped by command", is what it should say

    def close(self) -> None:
        """Stop, where that can still be said, and let go of the controller."""
        with contextlib.suppress(DeviceError):
            if self._link.connected:
                self.stop()
        self._link.close()

    def _introduce(self) -> None:
        """Learn who answers, and whether it has the axis."""
        self._device.errcheck = False
        self._device.qERR()  # what went wrong before is not this print's concern
        self._device.errcheck = True
        self.identity = str(self._device.qIDN())
        axes = [str(axis) for axis in self._device.axes]
        if self._axis not in axes:
            raise InputError("[stage.settings]", f"axis is {self._axis!r}", accepted=" or ".join(axes))
        self.kind = str(self._device.qCST(self._axis)[self._axis])

    def _refer(self) -> None:
        """Make the position known; the controller is busy meanwhile."""
        if self._settings.reference == "here":
            self._device.RON(self._axis, False)
            self._device.POS(self._axis, 0.0)
            return
        self._device.FRF(self._axis)
        deadline = time.monotonic() + _REFERENCE_S
        while not self._device.IsControllerReady():
            if time.monotonic() > deadline:
                raise DeviceError("stage", f"has not found its reference within {_REFERENCE_S:g} s")
            time.sleep(_POLL_S)
        self._device.checkerror()
        if not self._knows_where_it_is():
            raise DeviceError(
                "stage", "has not found its reference", 'where it has no switch, set reference = "here" in the rig'
            )

    def _knows_where_it_is(self) -> bool:
        return bool(self._device.qFRF(self._axis)[self._axis])

    def _here_deg(self) -> float:
        self._device.errcheck = False  # a second question would double the time
        try:
            return float(self._device.qPOS(self._axis)[self._axis])
        finally:
            self._device.errcheck = True

    def _room_deg(self, sense: int) -> float:
        """Return how far the stage can go on from where it is."""
        ask = self._device.qTMX if sense > 0 else self._device.qTMN
        return sense * (float(ask(self._axis)[self._axis]) - self._here_deg())

    def _look_for_errors(self) -> None:
        """Raise what the controller has to say, now and then: it says it once, and it is remembered."""
        if self._fault is not None:
            raise self._fault
        if time.monotonic() - self._errors_at > _ERRORS_EVERY_S:
            self._errors_at = time.monotonic()
            code = int(self._device.qERR())
            if code not in (0, _STOPPED):
                self._fault = DeviceError("stage", f"reports: {self._gcs_error(code)}")
                raise self._fault

    @contextlib.contextmanager
    def _talk(self, timeout_s: float) -> Iterator[None]:
        """Have the line for oneself, in step; what goes wrong is told as a device's error."""
        if not self._lock.acquire(timeout=timeout_s):
            raise DeviceTimeoutError("stage", f"is busy for more than {timeout_s:g} s")
        try:
            if self._is_out_of_step:
                self._link.resynchronise(self.identity, timeout_s)
                self._is_out_of_step = False
            self._link.settimeout(_milliseconds(timeout_s))
            yield
        except self._gcs_error as error:
            if error.val == _NO_ANSWER:
                self._is_out_of_step = True
                raise DeviceTimeoutError("stage", f"has not answered within {timeout_s:.2g} s") from error
            if error.val == _NONSENSE:
                raise self._nonsense(error) from error
            raise DeviceError("stage", f"refuses: {error}") from error
        except OSError as error:
            raise DeviceError("stage", f"the line is lost ({error})", "check its cable and that it is on") from error
        except (ValueError, IndexError, KeyError, TypeError) as error:
            raise self._nonsense(error) from error
        finally:
            self._lock.release()

    def _nonsense(self, error: Exception) -> DeviceError:
        self._is_out_of_step = True
        return DeviceError("stage", f"answers what makes no sense ({str(error).strip()})")


def _milliseconds(seconds: float) -> int:
    return max(1, int(seconds * 1000))
