"""Whether the instruments of a rig do what it asks of them, in plain words."""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from vialight.config import Camera as CameraTable
from vialight.config import ProjectorSettings, Rig
from vialight.devices import CameraFrame, DeviceError, DeviceTimeoutError, MonotonicClock, Stage
from vialight.devices.cameras import GenicamCamera, open_camera
from vialight.devices.projectors import Monitor, check_size, list_monitors
from vialight.devices.stages import reach_stage
from vialight.errors import InputError, VialightError, VialightWarning
from vialight.store import FrameWriter
from vialight.twin import find_rig

WATCHED_S = 3.0
"""For which frames are looked at."""
_FIRST_FRAME_S = 5.0
_RATE_TOLERANCE, _SPEED_TOLERANCE = 0.02, 0.02
_JITTER_DEG = 0.1
"""By which a frame's angle may be wrong: at the edge of the field a fifth of a pixel of the paper's camera."""
_SATURATED, _SATURATED_SHARE = 0.98, 1e-4
_BLACK = 0.01
"""Of the full level: an image that nowhere reaches it shows nothing."""
_SPARE = 2.0
"""By which the disk should be quicker than the camera."""
_SPEED_UP_S, _TURNED_S = 10.0, 3.0
_SLOW_ANSWER_S = 0.08
"""A print asks the stage 40 times a second, and takes one that answers later for silent."""


@dataclass(frozen=True)
class Finding:
    """What was found of a device."""

    device: str
    state: Literal["ok", "note", "wrong"]
    told: str
    remedy: str = ""


def check_instruments(
    rig_path: str | Path,
    *,
    frame_rate_hz: float = 10.0,
    move: bool = False,
    on_step: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Check each device that a rig names.

    No light is shown, and nothing moves unless that is allowed.

    Parameters
    ----------
    rig_path
        TOML, or the name of a preset.
    frame_rate_hz
        That the camera should keep.
    move
        Whether the stage may turn, for some seconds; where it does not know where it is, it finds its reference first.
    on_step
        Told in words what is done.

    Returns
    -------
    dict
        ``findings``, and ``is_well``: none of them is wrong.

    Raises
    ------
    InputError
        The rig cannot be read.
    """
    rig = find_rig(rig_path)
    findings: list[Finding] = []
    checks: dict[str, Callable[[], list[Finding]]] = {
        "camera": lambda: _camera(rig, frame_rate_hz),
        "stage": lambda: _stage(rig, move),
        "projector": lambda: _projector(rig),
    }
    for device, check in checks.items():
        if getattr(getattr(rig, device), "driver", None) is None:
            findings.append(Finding(device, "note", "the rig names no driver: the twin stands in"))
            continue
        on_step(f"checking the {device}")
        try:
            findings += check()
        except VialightError as error:
            findings.append(Finding(device, "wrong", str(error)))
    return {
        "rig": str(rig_path), "is_well": all(one.state != "wrong" for one in findings),
        "findings": [asdict(one) for one in findings],
    }  # fmt: skip


def _camera(rig: Rig, frame_rate_hz: float) -> list[Finding]:
    table = rig.need_camera()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VialightWarning)  # of rounded settings, which are told below
        camera = open_camera(table, MonotonicClock())
    with contextlib.closing(camera):
        findings = [Finding("camera", "ok", f"{camera.name} sends {_size(camera.image_shape)} pixels")]
        findings += [
            Finding("camera", "wrong", str(one), "write what it has into [camera.settings], and mind the axis_column")
            for one in camera.rounded
        ]
        findings += image_findings(table, camera.image_shape)
        camera.start(frame_rate_hz)
        frames = _watched(camera)
    findings += frame_findings(frames, frame_rate_hz, camera.full_level, rig.stage.speed_deg_s)
    if camera.incomplete:
        findings.append(
            Finding(
                "camera",
                "wrong",
                f"{camera.incomplete} frames lost a part on the way",
                "network: jumbo frames, no switch between, a card of its own; USB: another port or cable",
            )
        )
    return findings + _disk(frames, frame_rate_hz)


def _watched(camera: GenicamCamera) -> list[CameraFrame]:
    """Return the frames of some seconds, from the first on."""
    frames = [camera.next_frame(_FIRST_FRAME_S)]
    end = time.monotonic() + WATCHED_S
    while (left_s := end - time.monotonic()) > 0:
        with contextlib.suppress(DeviceTimeoutError):
            frames.append(camera.next_frame(left_s))
    return frames


def image_findings(table: CameraTable, image_shape: tuple[int, int]) -> list[Finding]:
    """Compare an image's size with what the rig says of it.

    Examples
    --------
    >>> table = CameraTable(pixel_mm=0.1, axis_column=240.0, optical_row=150.0)
    >>> [one.told for one in image_findings(table, (300, 200))]
    ['axis_column 240 lies outside the image of 200 x 300 pixels']
    """
    findings = []
    for key, position, size in (
        ("axis_column", table.axis_column, image_shape[1]), ("optical_row", table.optical_row, image_shape[0]),
    ):  # fmt: skip
        if not 0 <= position <= size - 1:
            told = f"{key} {position:g} lies outside the image of {_size(image_shape)} pixels"
            findings.append(Finding("camera", "wrong", told, "correct it, or region and binning in [camera.settings]"))
    return findings


def frame_findings(
    frames: list[CameraFrame], frame_rate_hz: float, full_level: int, speed_deg_s: float
) -> list[Finding]:
    """Judge frames of some seconds: what was lost, how even they came, how bright they are.

    Parameters
    ----------
    frames
        In the order in which they came.
    frame_rate_hz
        That was asked for.
    full_level
        Of the camera.
    speed_deg_s
        Of the stage: turns an error of time into one of angle.
    """
    if len(frames) < 3:
        remedy = "check the trigger: [camera.settings] trigger, and the signal"
        return [Finding("camera", "wrong", f"sent {len(frames)} frames in {WATCHED_S:g} s", remedy)]
    findings = []
    numbers = np.array([frame.number for frame in frames], dtype=np.float64)
    times = np.array([frame.time_s for frame in frames])
    lost = int(numbers.max() - numbers.min()) + 1 - len(frames)
    if lost > 0:
        remedy = "network or USB is too slow, or the machine too busy; a smaller region or fewer bits a pixel need less"
        findings.append(Finding("camera", "wrong", f"{lost} of {lost + len(frames)} frames were lost", remedy))
    period_s, begin_s = np.polyfit(numbers, times, 1)
    if abs(period_s * frame_rate_hz - 1) > _RATE_TOLERANCE:
        told = f"sends {1 / period_s:.4g} frames/s instead of {frame_rate_hz:g}"
        findings.append(Finding("camera", "wrong", told, "shorten the exposure; check the trigger's rate"))
    jitter_s = float(np.abs(times - begin_s - period_s * numbers).max())
    if jitter_s * speed_deg_s > _JITTER_DEG:
        told = f"times of frames are off by up to {1e3 * jitter_s:.1f} ms, {jitter_s * speed_deg_s:.2f} deg of turn"
        findings.append(Finding("camera", "wrong", told, "the camera has no clock of its own, or the machine is busy"))
    findings += _brightness(frames[-1], full_level)
    if not findings:
        told = f"{len(frames)} frames at {1 / period_s:.4g}/s, none lost, times even to {1e3 * jitter_s:.2f} ms"
        findings.append(Finding("camera", "ok", told))
    return findings


def _brightness(frame: CameraFrame, full_level: int) -> list[Finding]:
    share = float((frame.counts >= _SATURATED * full_level).mean())
    if share > _SATURATED_SHARE:
        told = f"{100 * share:.3g} % of the pixels are saturated at {full_level} counts"
        return [Finding("camera", "wrong", told, "shorten exposure_s or lower gain_db or the light")]
    if (most := int(frame.counts.max())) < _BLACK * full_level:
        told = f"the image is black: at most {most} of {full_level} counts"
        return [Finding("camera", "wrong", told, "take off the lens cap, switch the light on, lengthen exposure_s")]
    return []


def _disk(frames: list[CameraFrame], frame_rate_hz: float) -> list[Finding]:
    """Write the frames as a recording would, in the current folder."""
    try:
        with tempfile.TemporaryDirectory(dir=".", prefix="vialight-doctor-") as folder:
            begun = time.monotonic()
            with FrameWriter(Path(folder) / "frames.h5", (frames[0].counts.shape[0], frames[0].counts.shape[1])) as to:
                for frame in frames:
                    to.append(frame.counts, 0.0, frame.time_s)
            rate_hz = len(frames) / (time.monotonic() - begun)
    except (OSError, InputError) as error:
        return [Finding("disk", "wrong", f"cannot be written ({error})", "change to the folder of your recordings")]
    told = f"takes {rate_hz:.0f} frames/s here; the camera sends {frame_rate_hz:g}"
    is_quick = rate_hz >= _SPARE * frame_rate_hz
    return [Finding("disk", "ok" if is_quick else "wrong", told, "" if is_quick else "record on a quicker disk")]


def _stage(rig: Rig, move: bool) -> list[Finding]:
    with contextlib.closing(reach_stage(rig.stage, MonotonicClock())) as stage:
        slowest_s = _slowest_answer_s(stage)
        findings = [Finding("stage", "ok", f"answers within {1e3 * slowest_s:.1f} ms")]
        if slowest_s > _SLOW_ANSWER_S:
            told = f"takes {1e3 * slowest_s:.0f} ms to answer; a print waits for {1e3 * _SLOW_ANSWER_S:.0f}"
            findings = [Finding("stage", "wrong", told, "use USB or a cable of its own; raise the baud rate")]
        if not move:
            told = "was not turned" + ("" if stage.is_referenced() else "; it does not know where it is")
            return [*findings, Finding("stage", "note", told, "take your hands away, and run doctor with --move")]
        wanted = rig.stage.speed_deg_s
        stage.prepared().start(math.radians(wanted))
        try:
            speed, ripple_deg = _speed_deg_s(stage, wanted)
        finally:
            stage.stop()
    if abs(abs(speed) / wanted - 1) > _SPEED_TOLERANCE:
        told = f"turns at {speed:.2f} deg/s instead of {wanted:g}"
        return [*findings, Finding("stage", "wrong", told, "check its largest velocity, its load and its servo")]
    return [*findings, Finding("stage", "ok", f"turns at {speed:.3f} deg/s, even to {ripple_deg:.3f} deg")]


def _slowest_answer_s(stage: Stage) -> float:
    took = []
    for _ in range(20):
        begun = time.monotonic()
        stage.position(1.0)
        took.append(time.monotonic() - begun)
    return max(took)


def _speed_deg_s(stage: Stage, wanted: float) -> tuple[float, float]:
    """Return the speed once it is reached, or cannot be, and by how much angles leave the straight line."""
    deadline = time.monotonic() + _SPEED_UP_S
    while True:
        times, angles = _positions(stage, 0.3)
        speed = np.polyfit(times, angles, 1)[0]
        if abs(abs(speed) / wanted - 1) < _SPEED_TOLERANCE or time.monotonic() > deadline:
            break
    times, angles = _positions(stage, _TURNED_S)
    speed, begin = np.polyfit(times, angles, 1)
    return float(speed), float(np.abs(angles - begin - speed * times).max())


def _positions(stage: Stage, seconds: float) -> tuple[Any, Any]:
    end = time.monotonic() + seconds
    told = []
    while time.monotonic() < end:
        told.append(stage.position(1.0))
        time.sleep(0.02)
    times = np.array([one.time_s for one in told])
    return times - times[0], np.degrees([one.angle_rad for one in told])


def _projector(rig: Rig) -> list[Finding]:
    table = rig.need_projector()
    wanted = (table.settings or ProjectorSettings()).monitor
    monitors = list_monitors()
    chosen = [one for one in monitors if wanted in (one.index, one.name)]
    if not chosen:
        there = "; ".join(map(str, monitors)) or "none"
        raise DeviceError(
            "projector", f"monitor {wanted!r} is not there; found: {there}", "connect it, or name another"
        )
    return monitor_findings(chosen[0], table.columns, table.rows, table.frame_rate_hz)


def monitor_findings(monitor: Monitor, columns: int, rows: int, frame_rate_hz: float) -> list[Finding]:
    """Compare a monitor with the projector of a rig.

    Examples
    --------
    >>> [one.told for one in monitor_findings(Monitor(1, "DLP", 1280, 800, 60), 1280, 800, 32.0)]
    ['monitor 1: DLP, 1280 x 800 at 60 Hz']
    """
    try:
        check_size(monitor, (columns, rows))
    except DeviceError as error:
        return [Finding("projector", "wrong", str(error))]
    if monitor.refresh_hz < frame_rate_hz:
        told = f"monitor {monitor} is slower than frame_rate_hz {frame_rate_hz:g}"
        return [Finding("projector", "wrong", told, "choose a quicker mode, or lower frame_rate_hz")]
    return [Finding("projector", "ok", f"monitor {monitor}")]


def _size(image_shape: tuple[int, int]) -> str:
    return f"{image_shape[1]} x {image_shape[0]}"
