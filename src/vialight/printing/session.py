"""A print from its first check to its last frame, in order."""

from __future__ import annotations

import contextlib
import gc
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.arrays import TURN_RAD
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.messages import CameraImage, PrintStatus, StopForecast
from vialight.devices import DeviceError, Devices
from vialight.devices.panel import LightPanel
from vialight.printing import preflight
from vialight.printing.doubts import doubts_of_background
from vialight.printing.light import LightOwner, LightRules
from vialight.printing.live_link import LiveLink
from vialight.printing.log import EventLog
from vialight.printing.order_channel import ControlServer
from vialight.printing.recorder import Recorder, room_for
from vialight.printing.settings import PrintSettings, StopMode
from vialight.printing.track import LONGEST_GAP_S, StageTrack
from vialight.printing.watching import Watcher
from vialight.store import FrameWriter, open_frames
from vialight.system import wait_for
from vialight.system.mailboxes import Mailbox

_TICK_S = 0.02
_STATUS_S = 0.2
_START_TIMEOUT_S = 30.0
_READY_TIMEOUT_S = 180.0
_SPEED_TOLERANCE = 0.02
_DARK_TIMEOUT_S = 1.0
_SAID_BY_S = 0.5
_SYNC_S = 5.0
"""That a phase waits for the disk: the light itself waits for none."""


def print_plan(
    rig: Rig, devices: Devices, run: Path, mailboxes: Path, settings: PrintSettings, watcher: Watcher, *,
    keep_going: Callable[[], bool] = lambda: True, on_status: Callable[[PrintStatus], None] = lambda status: None,
    doubts: Sequence[str] = (),
) -> dict[str, Any]:  # fmt: skip
    """Print, and record all of it.

    Parameters
    ----------
    rig
        As the frames are recorded, with the resin's threshold.
    devices
        Ready, and black.  They are not closed here.
    run
        The run's folder, which exists.
    mailboxes
        Folder for ``status`` and ``camera``.
    settings
        How.
    watcher
        Forecasts the stop; the light is held while it has a fault.
    keep_going
        Asked all the time: False ends the light at once, and then the print in its usual way.
    on_status
        Called a few times a second.
    doubts
        Of the rig's calibration, as known so far; told with what the background shows.

    Returns
    -------
    dict
        What is known of the print: lit time and turns, frames, who ended it.

    Raises
    ------
    InputError
        A check before the print fails.
    DeviceError
        A device fails before there is light.
    """
    session = _Session(rig, devices, run, mailboxes, settings, watcher, keep_going, on_status, doubts)
    with ControlServer(mailboxes, session.obey) as control:
        LiveLink.of_this_process(mailboxes, control.key, control.port).publish(run)
        try:
            session.prepare()
            session.take_background()
            session.expose()
            session.look_once_more()
        except _StoppedEarlyError:
            session.note_the_end()
        except BaseException as error:
            session.fail(error)
            raise
        finally:
            session.end()
            LiveLink.withdraw(run)
    return session.record()


class _StoppedEarlyError(Exception):
    """The light was ended before it began: there is nothing more to wait for."""


class _Session:
    """The state of one print; its methods are the steps of `print_plan`."""

    def __init__(
        self, rig: Rig, devices: Devices, run: Path, mailboxes: Path, settings: PrintSettings, watcher: Watcher,
        keep_going: Callable[[], bool], on_status: Callable[[PrintStatus], None], doubts: Sequence[str],
    ) -> None:  # fmt: skip
        self._rig, self._devices, self._run, self._settings = rig, devices, run, settings
        self._watcher, self._on_status = watcher, on_status
        self._speed = float(np.radians(rig.stage.speed_deg_s))
        self._log = EventLog(run / "log.jsonl", devices.clock)
        self._doubts = tuple(doubts)
        self._track = StageTrack(LONGEST_GAP_S * devices.clock.rate)
        self._camera_box = Mailbox(
            mailboxes / "camera", CameraImage, 2**16 + 2 * int(np.prod(devices.camera.image_shape))
        )
        self._status_box = Mailbox(mailboxes / "status", PrintStatus, 2**16)
        self._recorder = Recorder(
            devices.camera,
            devices.clock,
            settings.frame_rate_hz,
            self._track.settled_angle_at,
            self._log,
            self._show_frame,
        )
        checks = {"camera": self._recorder.camera_fault, "disk": self._recorder.disk_fault, "live": watcher.fault}
        self._panel = LightPanel(mailboxes)
        rules = LightRules(rig.stage.direction * self._speed, self._lit_s_to_stop, checks, keep_going)
        self._light = LightOwner(devices, self._track, rules, self._panel, self._log)
        self._image: CameraImage | None = None
        self._mode: StopMode = settings.stop
        self._extra_turns = 0.0
        self._forecast: StopForecast | None = None
        self._gave_up_on: str | None = None
        self._state = "preflight"
        self._status_at = 0.0

    @property
    def _turn_s(self) -> float:
        return TURN_RAD / self._speed

    def prepare(self) -> None:
        """Check everything, and bring the stage up to speed."""
        self._log.note("start", "checking devices", settings=asdict(self._settings))
        preflight.check_rig(self._rig, self._devices.camera.image_shape)
        preflight.check_dark(self._devices)
        self._devices.stage.position(timeout_s=1.0)
        self._devices.camera.start(self._settings.frame_rate_hz)
        self._recorder.start()
        self._light.start()
        self._devices.stage.start(self._speed)
        self._wait(lambda: self._image is not None, "camera", "has sent no frame")
        assert self._image is not None
        preflight.check_exposure(self._image.counts, self._devices.camera.full_level)
        turns = self._settings.longest_turns + self._settings.after_turns + 2
        frames = int(turns * self._turn_s * self._settings.frame_rate_hz)
        others = self._watcher.room_for(self._devices.camera.image_shape, turns)
        preflight.check_room(self._run, self._image.counts, frames, others)
        self._wait(self._is_up_to_speed, "stage", "does not reach its speed")

    def take_background(self) -> None:
        """Record a turn in the dark, and begin the recording proper with its mean."""
        self._enter("background", "recording the background")
        path = self._run / "background.h5"
        shape = self._devices.camera.image_shape
        self._recorder.write_to(FrameWriter(path, shape))
        # A frame more, so that its ends meet.
        self._pass_time(self._turn_s + 1 / self._settings.frame_rate_hz)
        self._recorder.write_to(None)
        with open_frames(path) as frames:
            dark, angles_rad = frames.read(slice(None)), frames.angles_rad
        self._doubts += tuple(doubts_of_background(self._rig, dark, angles_rad))
        for doubt in self._doubts:
            self._log.note("doubt", doubt)
        settings = {"frame_rate_hz": self._settings.frame_rate_hz}
        self._recorder.write_to(FrameWriter(self._run / "frames.h5", shape, dark=dark, settings=settings))
        self._wait(lambda: self._recorder.written > 0, "camera", "has sent no frame")
        self._watcher.start()
        self._wait(
            lambda: self._watcher.is_ready() or self._watcher.has_ended(), "live", "is not ready", _READY_TIMEOUT_S
        )
        if self._watcher.has_ended():
            raise DeviceError("live measurement", self._watcher.fault() or "has ended")

    def expose(self) -> None:
        """Let light through until it is enough."""
        self._enter("printing", "light on")
        self._light.permit()
        held_since: float | None = None
        with _short_pauses_for_garbage():
            while not self._light.is_over:
                self._tick()
                fault, now = self._light.fault, time.monotonic()
                self._state = "printing" if fault is None else "dark"
                held_since = None if fault is None else held_since or now
                if held_since is not None:
                    self._watcher_again()
                    if now - held_since > self._settings.give_up_s / self._devices.clock.rate:
                        self._gave_up_on = fault
                        self._light.end("fault", f"given up: {fault}")
        if self._light.ended_by == "fault":
            self._gave_up_on = self._gave_up_on or self._light.fault
        self.note_the_end()

    def note_the_end(self) -> None:
        """Write down who ended the light, and when; whoever pressed the switch says so a moment later."""
        wait_for(lambda: self._light.ended_by != "stop", timeout_s=_SAID_BY_S)
        by = self._ended_by()
        self._log.note("stop", f"light off after {self._light.lit_s:.1f} s ({by})", by=by,
                       forecast=None if self._forecast is None else asdict(self._forecast))  # fmt: skip

    def look_once_more(self) -> None:
        """Image on in the dark: these frames make the final shape."""
        self._enter("after", "light off; imaging on")
        if (self._gave_up_on or self._light.fault) is None:
            self._pass_time(self._settings.after_turns * self._turn_s + 2 / self._settings.frame_rate_hz, is_after=True)

    def fail(self, error: BaseException) -> None:
        """Note why the print has ended too early."""
        self._light.end(type(error).__name__)
        self._state = "failed"
        self._log.note("fault", f"the print has failed: {error or type(error).__name__}")

    def end(self) -> None:
        """Light off first; then everything else comes to rest, and what is recorded is kept."""
        self._light.close()
        for act in (self._recorder.close, self._devices.stage.stop, self._watcher.close):
            try:
                act()
            except (DeviceError, InputError, OSError) as error:
                self._log.note("fault", str(error))
        if self._state != "failed":
            self._enter("finishing", "the print is over")
        self._publish()
        self._log.close()

    def record(self) -> dict[str, Any]:
        """Return what is known of the print."""
        return {
            "ended_by": self._ended_by(),
            "lit_s": round(self._light.lit_s, 3),
            "lit_turns": round(self._light.lit_rad / TURN_RAD, 4),
            "frames": self._recorder.written,
            "frames_missed": self._recorder.missed,
            "fault": self._gave_up_on or self._light.fault,
            "forecast": None if self._forecast is None else asdict(self._forecast),
            "doubts": list(self._doubts),
        }

    def obey(self, order: Mapping[str, Any]) -> dict[str, Any]:
        """Carry out an order from the page or another program: Stop first of all, and written down afterwards."""
        do, by = order.get("do"), str(order.get("by", "unknown"))[:80]
        if do == "stop":
            self._light.end(by, f"stopped ({by})")
            wait_for(lambda: self._panel.is_dark_for_good, timeout_s=_DARK_TIMEOUT_S, every_s=0.002)
        self._log.note("order", f"{do} ({by})"[:200], order={key: order[key] for key in list(order)[:4]})
        if do == "extend":
            turns = order.get("turns", 1.0)
            if not (isinstance(turns, int | float) and -100 <= turns <= 100):
                raise InputError("extend", f"turns is {turns!r}"[:200], accepted="a number of turns")
            self._extra_turns += float(turns)
        elif do == "mode" and order.get("mode") in ("auto", "manual"):
            self._mode = order["mode"]
        elif do != "stop":
            raise InputError("order", f"is {dict(order)!r}"[:200], accepted="stop, extend, mode auto or manual")
        return {
            "mode": self._mode,
            "extra_turns": self._extra_turns,
            "is_over": self._light.is_over,
            "is_dark": self._panel.is_dark_for_good,
        }

    def _ended_by(self) -> str:
        """Return who ended the light; the mode where it has had what it was to have."""
        by = self._light.ended_by
        return self._mode if by in ("", "done") else by

    def _lit_s_to_stop(self) -> float:
        """Return after how much light the print ends, as far as known."""
        longest = self._settings.longest_turns * self._turn_s
        extra = self._extra_turns * self._turn_s
        self._forecast = self._watcher.forecast() or self._forecast
        if self._mode == "auto" and self._forecast is not None:
            return min(self._forecast.stop_s + extra, longest)
        if self._mode == "turns" and self._settings.turns is not None:
            # Turns are counted as angle: a stage that is slow gets its light all the same.
            left = (self._settings.turns + self._extra_turns) * TURN_RAD - self._light.lit_rad
            return min(self._light.lit_s + left / self._speed, longest)
        return longest

    def _watcher_again(self) -> None:
        """Start the watcher anew where it has died; it catches up from the recording."""
        if self._watcher.fault() and self._watcher.has_ended():
            self._log.note("live", "starting the live measurement again")
            self._watcher.start()

    def _is_up_to_speed(self) -> bool:
        return abs(abs(self._track.speed_rad_s()) / self._speed - 1) < _SPEED_TOLERANCE

    def _show_frame(self, image: CameraImage) -> None:
        self._image = image
        with contextlib.suppress(InputError):  # no memory left to show it: it is recorded, and that is what counts
            self._camera_box.put(image)

    def _enter(self, state: str, message: str) -> None:
        """Begin a phase, once all frames of the one before are on the disk for certain, or cannot be."""
        if (fault := self._recorder.sync(_SYNC_S)) is not None:
            self._log.note("fault", f"frames are not on the disk for certain: {fault}")
        self._state = state
        self._log.note("state", message, state=state)
        self._publish()

    def _tick(self) -> None:
        time.sleep(_TICK_S)
        self._show_now_and_then()

    def _show_now_and_then(self) -> None:
        if time.monotonic() - self._status_at > _STATUS_S:
            self._publish()

    def _pass_time(self, duration_s: float, *, is_after: bool = False) -> None:
        end = self._devices.clock.now_s() + duration_s
        patience_s = (2 * duration_s + 10) / min(1.0, self._devices.clock.rate) + 8 * duration_s

        def has_passed() -> bool:
            return self._devices.clock.now_s() >= end

        self._wait(has_passed, "print", "time does not pass", patience_s, is_after=is_after)

    def _wait(
        self, until: Callable[[], bool], device: str, fault: str, timeout_s: float = _START_TIMEOUT_S, *,
        is_after: bool = False,
    ) -> None:  # fmt: skip
        """Wait; before the light has begun, until it is ended at the longest."""
        timeout_s /= min(1.0, self._devices.clock.rate)
        told = wait_for(
            lambda: until() or (self._light.is_over and not is_after), timeout_s=timeout_s, tick=self._show_now_and_then
        )
        if told is not None:
            raise DeviceError(device, f"{fault} ({told})")
        if self._light.is_over and not is_after:
            raise _StoppedEarlyError

    def _publish(self) -> None:
        self._status_at = time.monotonic()
        now, lit_s = self._devices.clock.now_s(), self._light.lit_s
        needed, free = room_for(self._run, self._image.counts, 1) if self._image is not None else (1, 0)
        to_stop = self._lit_s_to_stop() if self._state in ("printing", "dark") else None
        status = PrintStatus(
            state=self._state, message=self._log.last, time_s=now, lit_s=lit_s,
            turn=self._light.lit_rad / TURN_RAD, remaining_s=None if to_stop is None else max(0.0, to_stop - lit_s),
            mode=self._mode, frames=self._recorder.written, missed=self._recorder.missed, disk_free_bytes=free,
            disk_left_s=free / needed / self._settings.frame_rate_hz, pattern=self._light.pattern,
            devices={"camera": "ok", "stage": "ok", "projector": "ok", "disk": "ok", "live": "ok"}
            | self._light.devices_health,
            doubts=self._doubts,
        )  # fmt: skip
        with contextlib.suppress(InputError):  # no memory left to show it
            self._status_box.put(status)
        self._on_status(status)


@contextlib.contextmanager
def _short_pauses_for_garbage() -> Iterator[None]:
    """Keep the interpreter from looking through all that was there before whenever it clears memory away."""
    gc.freeze()  # without a collection before it, which would itself hold up the light's thread
    try:
        yield
    finally:
        gc.unfreeze()
