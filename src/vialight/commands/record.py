"""Image a thing that turns, without printing: frames with their angles and times."""

from __future__ import annotations

import contextlib
import math
import os
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD
from vialight.core.config import Rig
from vialight.core.errors import InputError, VialightWarning
from vialight.core.messages import CameraImage
from vialight.devices import Camera, Clock, DeviceError, MonotonicClock, Stage
from vialight.devices.opening import open_camera, open_stage
from vialight.devices.simulated import SimulatedPrinter, WorldSettings
from vialight.printing.log import EventLog
from vialight.printing.preflight import check_exposure, check_room
from vialight.printing.recorder import Recorder
from vialight.printing.track import StageFollower, StageTrack
from vialight.store import FrameWriter, rig_to_toml
from vialight.store.provenance import versions
from vialight.system import wait_for
from vialight.twin import find_rig, resin_names

_START_S = 30.0
"""In which the first frame comes and the stage gets up to speed."""
_SETTLE_S = 1.0
"""In which the camera's clock is learnt."""
_GIVE_UP_S = 5.0
"""For which camera or stage may be silent."""
_SPEED_TOLERANCE = 0.02
_TWIN_RESIN = "DUDMA"


@dataclass(frozen=True)
class RecordSettings:
    """What to record.

    Parameters
    ----------
    turns
        Of the stage.
    dark_frames
        To take first, without the object.
    frame_rate_hz
        Of the camera.
    part
        What stands in the vial of the twin; by default that of the sample print.
    """

    turns: float = 1.0
    dark_frames: int = 0
    frame_rate_hz: float = 10.0
    part: Path | None = None

    def __post_init__(self) -> None:
        if not (math.isfinite(self.turns) and 0 < self.turns <= 1000):
            raise InputError("--turns", f"is {self.turns}", accepted="more than 0, at most 1000")
        if not 0 <= self.dark_frames <= 1000:
            raise InputError("--dark", f"is {self.dark_frames}", accepted="0 to 1000 frames")
        if not (math.isfinite(self.frame_rate_hz) and 0.5 <= self.frame_rate_hz <= 200):
            raise InputError("--rate", f"is {self.frame_rate_hz} frames/s", accepted="0.5 to 200")


def record_turns(
    rig_path: str | Path,
    out: str | Path,
    *,
    settings: RecordSettings | None = None,
    keep_going: Callable[[], bool] = lambda: True,
    put_in: Callable[[], None] = lambda: None,
    progress: Callable[[int, int], None] = lambda done, total: None,
    on_step: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Record a turning thing with the camera and the stage that a rig names, or else with its twin.

    Parameters
    ----------
    rig_path
        TOML, or the name of a preset.
    out
        The recording, a new HDF5 file.  What was odd stands beside it, in ``.log.jsonl``.
    settings
        What to record.
    keep_going
        Asked all the time; False ends the recording, with what there is.
    put_in
        Called when the dark frames are taken: returns when the object stands in the vial.
    progress
        Called with frames recorded and expected.
    on_step
        Told in words what is done.

    Returns
    -------
    dict
        What is known of the recording.

    Raises
    ------
    InputError
        Rig or settings cannot be used, or the file cannot be written.
    DeviceError
        A device fails; frames that were recorded before stay.
    """
    settings, rig, out = settings or RecordSettings(), find_rig(rig_path), Path(out)
    if out.exists():
        raise InputError(out, "exists already", accepted="a new name", remedy="move it out of the way")
    on_step("opening camera and stage")
    with _instruments(rig, str(rig_path), settings, put_in) as (instruments, set_up), contextlib.ExitStack() as stack:
        scan = _Scan(rig, instruments, out, settings, keep_going, stack)
        darks = scan.take_darks(on_step)
        if darks is not None:
            on_step("dark frames are taken; now the object")
        set_up()
        on_step("starting the stage")
        scan.get_up_to_speed()
        on_step(f"recording {settings.turns:g} turns")
        return scan.record(darks, progress)


@dataclass(frozen=True)
class _Instruments:
    clock: Clock
    camera: Camera
    stage: Stage


@contextlib.contextmanager
def _instruments(
    rig: Rig, rig_path: str, settings: RecordSettings, put_in: Callable[[], None]
) -> Iterator[tuple[_Instruments, Callable[[], None]]]:
    """Open what the rig names, or the twin; with what puts the object into the vial."""
    named = {"[camera]": rig.need_camera().driver, "[stage]": rig.stage.driver}
    if any(named.values()):
        for table, driver in named.items():
            if driver is None:
                (other,) = set(named) - {table}
                raise InputError(
                    rig.source, f"names a driver for {other}, none for {table}", accepted="both, or none for the twin"
                )
        if settings.part is not None:
            raise InputError("--part", "is for the twin, but the rig names devices", remedy="leave it out")
        clock = MonotonicClock()
        with contextlib.ExitStack() as opened:
            camera = open_camera(rig, clock)
            opened.callback(camera.close)
            stage = open_stage(rig, clock)
            opened.callback(stage.close)
            yield _Instruments(clock, camera, stage), put_in if settings.dark_frames else lambda: None
        return
    with as_file(files("vialight") / "commands" / "sample" / "part.stl") as sample:
        resin = rig.resin.name if rig.resin.name in resin_names() else _TWIN_RESIN
        world = WorldSettings(None, rig_path, resin, part_path=settings.part or sample)
        with SimulatedPrinter(world, np.zeros(1), rig.need_projector().frame_rate_hz, Path(os.devnull)) as printer:
            devices = printer.devices
            yield _Instruments(devices.clock, devices.camera, devices.stage), printer.put_in


class _Scan:
    """The state of one recording; its methods are its steps."""

    def __init__(
        self, rig: Rig, instruments: _Instruments, out: Path, settings: RecordSettings,
        keep_going: Callable[[], bool], stack: contextlib.ExitStack,
    ) -> None:  # fmt: skip
        self._rig, self._out, self._settings, self._keep_going = rig, out, settings, keep_going
        self._clock, self._camera, self._stage = instruments.clock, instruments.camera, instruments.stage
        self._speed = math.radians(rig.stage.speed_deg_s)
        self._track = StageTrack()
        self._darks: list[NDArray[np.uint16]] = []
        self._image: CameraImage | None = None
        self._begun_rad: float | None = None
        self._turned_rad = 0.0
        log = EventLog(out.with_suffix(".log.jsonl"), self._clock)
        stack.callback(log.close)
        rate_hz = settings.frame_rate_hz
        self._recorder = Recorder(self._camera, self._clock, rate_hz, self._track.settled_angle_at, log, self._see)
        self._camera.start(rate_hz)
        self._recorder.start()
        stack.callback(self._recorder.close)
        self._follower = StageFollower(self._stage, self._track)
        stack.callback(self._stage.stop)
        stack.callback(self._follower.close)

    def take_darks(self, on_step: Callable[[str], None]) -> NDArray[np.uint16] | None:
        """Return the dark frames that are asked for, (frame, row, column)."""
        self._wait(lambda: self._image is not None, "camera", "has sent no frame")
        if self._settings.dark_frames == 0:
            return None
        on_step(f"taking {self._settings.dark_frames} dark frames: nothing may scatter yet")
        seconds = self._settings.dark_frames / self._settings.frame_rate_hz
        self._darks = []
        self._wait(
            lambda: len(self._darks) >= self._settings.dark_frames, "camera", "has not sent the dark frames",
            _START_S + 2 * seconds,
        )  # fmt: skip
        return np.stack(self._darks[: self._settings.dark_frames])

    def get_up_to_speed(self) -> None:
        """Turn the stage, and check what can be known before the first frame."""
        self._stage.start(self._speed)
        self._wait(self._is_up_to_speed, "stage", "does not reach its speed")
        settled = self._clock.now_s() + _SETTLE_S
        self._wait(lambda: self._clock.now_s() >= settled, "camera", "time does not pass")
        assert self._image is not None
        try:
            check_exposure(self._image.counts, self._camera.full_level)
        except InputError as error:
            warnings.warn(str(error), VialightWarning, stacklevel=2)
        check_room(self._out.parent, self._image.counts, self._expected())

    def record(self, darks: NDArray[np.uint16] | None, progress: Callable[[int, int], None]) -> dict[str, Any]:
        """Record until the turns are full, the user has enough, or a device fails."""
        known = {
            "rig": rig_to_toml(self._rig), "frame_rate_hz": self._settings.frame_rate_hz,
            "camera": getattr(self._camera, "name", "twin"), "exposure_s": getattr(self._camera, "exposure_s", None),
        }  # fmt: skip
        missed = self._recorder.missed
        self._recorder.write_to(FrameWriter(self._out, self._camera.image_shape, dark=darks, settings=known))
        begun, to_turn = time.monotonic(), self._settings.turns * TURN_RAD
        expected_s = self._settings.turns * TURN_RAD / self._speed
        fault = wait_for(
            lambda: self._turned_rad >= to_turn or not self._keep_going(), self._fault, 2 * expected_s + _START_S,
            tick=lambda: progress(self._recorder.written, self._expected()),
        )  # fmt: skip
        frames = self._recorder.written
        try:
            frames = self._recorder.write_to(None)
        except DeviceError as error:
            fault = fault or str(error)
        if fault is not None:
            raise DeviceError("recording", f"has ended early: {fault}", self._kept(frames))
        if frames == 0:
            self._kept(frames)
            raise InputError(self._out, "holds no frame", remedy="let it record for longer")
        return {
            "file": str(self._out), "frames": frames, "frames_missed": self._recorder.missed - missed,
            "turns": round(self._turned_rad / TURN_RAD, 4), "dark_frames": 0 if darks is None else len(darks),
            "is_complete": self._turned_rad >= to_turn, "image_shape": list(self._camera.image_shape),
            "elapsed_s": round(time.monotonic() - begun, 3), "versions": versions(),
        } | {name: known[name] for name in ("camera", "exposure_s", "frame_rate_hz")}  # fmt: skip

    def _kept(self, frames: int) -> str:
        """Say what is kept; a file without frames is not."""
        if frames == 0:
            self._out.unlink(missing_ok=True)
        return f"{frames} frames are kept"

    def _expected(self) -> int:
        turn_s = TURN_RAD / self._speed
        return int(self._settings.turns * turn_s * self._settings.frame_rate_hz) + 1

    def _see(self, image: CameraImage) -> None:
        self._image = image
        if len(self._darks) < self._settings.dark_frames:
            self._darks.append(image.counts)
        if image.frame >= 0:
            # What counts is what is in the file: a frame comes some time after the stage has been there.
            angle_rad = math.radians(image.angle_deg)
            self._begun_rad = angle_rad if self._begun_rad is None else self._begun_rad
            self._turned_rad = max(self._turned_rad, abs(angle_rad - self._begun_rad))

    def _is_up_to_speed(self) -> bool:
        return abs(abs(self._track.speed_rad_s()) / self._speed - 1) < _SPEED_TOLERANCE

    def _fault(self) -> str | None:
        """Say what ends a recording: a full disk at once, a device that is silent after a while."""
        if told := self._recorder.disk_fault() or self._follower.fault(_GIVE_UP_S):
            return told
        silent_s = 0.0 if self._image is None else time.monotonic() - self._image.arrived_monotonic_s
        return f"camera: silent for {silent_s:.0f} s" if silent_s > _GIVE_UP_S else None

    def _wait(self, until: Callable[[], bool], device: str, fault: str, timeout_s: float = _START_S) -> None:
        told = wait_for(
            lambda: until() or not self._keep_going(), lambda: self._follower.fault(_GIVE_UP_S), timeout_s
        )  # fmt: skip
        if not self._keep_going():
            raise DeviceError("recording", "was interrupted before its first frame", "nothing is kept")
        if told is not None:
            raise DeviceError(device, f"{fault} within {timeout_s:.0f} s" if told.startswith("not within") else told)
