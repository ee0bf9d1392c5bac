"""Whether the instruments of a rig do what it asks of them, in plain words."""

from __future__ import annotations

import contextlib
import math
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from vialight.commands.doctor_findings import (
    WATCHED_S,
    DoctorFinding,
    frame_findings,
    image_findings,
    monitor_findings,
    session_findings,
    size_words,
)
from vialight.core.config import ProjectorSettings, Rig
from vialight.core.errors import InputError, VialightError, VialightWarning
from vialight.devices import CameraFrame, DeviceError, DeviceTimeoutError, MonotonicClock, Stage
from vialight.devices.cameras import GenicamCamera, open_camera
from vialight.devices.projectors import list_monitors
from vialight.devices.stages import reach_stage
from vialight.store import FrameWriter
from vialight.twin import find_rig

_FIRST_FRAME_S = 5.0
_SPEED_TOLERANCE = 0.02
_SPARE = 2.0
"""By which the disk should be quicker than the camera."""
_SPEED_UP_S, _TURNED_S = 10.0, 3.0
_SLOW_ANSWER_S = 0.08
"""A print asks the stage 40 times a second, and takes one that answers later for silent."""


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
    findings: list[DoctorFinding] = []
    checks: dict[str, Callable[[], list[DoctorFinding]]] = {
        "camera": lambda: _camera(rig, frame_rate_hz),
        "stage": lambda: _stage(rig, move),
        "projector": lambda: _projector(rig),
    }
    for device, check in checks.items():
        if getattr(getattr(rig, device), "driver", None) is None:
            findings.append(DoctorFinding(device, "note", "the rig names no driver: the twin stands in"))
            continue
        on_step(f"checking the {device}")
        try:
            findings += check()
        except VialightError as error:
            findings.append(DoctorFinding(device, "wrong", str(error)))
    return {
        "rig": str(rig_path), "is_well": all(one.state != "wrong" for one in findings),
        "findings": [asdict(one) for one in findings],
    }  # fmt: skip


def _camera(rig: Rig, frame_rate_hz: float) -> list[DoctorFinding]:
    table = rig.need_camera()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", VialightWarning)  # of rounded settings, which are told below
        camera = open_camera(table, MonotonicClock())
    with contextlib.closing(camera):
        findings = [DoctorFinding("camera", "ok", f"{camera.name} sends {size_words(camera.image_shape)} pixels")]
        findings += [
            DoctorFinding(
                "camera", "wrong", str(one), "write what it has into [camera.settings], and mind the axis_column"
            )
            for one in camera.rounded
        ]
        findings += image_findings(table, camera.image_shape)
        camera.start(frame_rate_hz)
        frames = _watched(camera)
    findings += frame_findings(frames, frame_rate_hz, camera.full_level, rig.stage.speed_deg_s)
    if camera.incomplete:
        findings.append(
            DoctorFinding(
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


def _disk(frames: list[CameraFrame], frame_rate_hz: float) -> list[DoctorFinding]:
    """Write the frames as a recording would, in the current folder."""
    try:
        with tempfile.TemporaryDirectory(dir=".", prefix="vialight-doctor-") as folder:
            begun = time.monotonic()
            with FrameWriter(Path(folder) / "frames.h5", (frames[0].counts.shape[0], frames[0].counts.shape[1])) as to:
                for frame in frames:
                    to.append(frame.counts, 0.0, frame.time_s)
            rate_hz = len(frames) / (time.monotonic() - begun)
    except (OSError, InputError) as error:
        return [
            DoctorFinding("disk", "wrong", f"cannot be written ({error})", "change to the folder of your recordings")
        ]
    told = f"takes {rate_hz:.0f} frames/s here; the camera sends {frame_rate_hz:g}"
    is_quick = rate_hz >= _SPARE * frame_rate_hz
    return [DoctorFinding("disk", "ok" if is_quick else "wrong", told, "" if is_quick else "record on a quicker disk")]


def _stage(rig: Rig, move: bool) -> list[DoctorFinding]:
    with contextlib.closing(reach_stage(rig.stage, MonotonicClock())) as stage:
        slowest_s = _slowest_answer_s(stage)
        findings = [DoctorFinding("stage", "ok", f"answers within {1e3 * slowest_s:.1f} ms")]
        if slowest_s > _SLOW_ANSWER_S:
            told = f"takes {1e3 * slowest_s:.0f} ms to answer; a print waits for {1e3 * _SLOW_ANSWER_S:.0f}"
            findings = [DoctorFinding("stage", "wrong", told, "use USB or a cable of its own; raise the baud rate")]
        if not move:
            told = "was not turned" + ("" if stage.is_referenced() else "; it does not know where it is")
            return [*findings, DoctorFinding("stage", "note", told, "take your hands away, and run doctor with --move")]
        wanted = rig.stage.speed_deg_s
        stage.prepared().start(math.radians(wanted))
        try:
            speed, ripple_deg = _speed_deg_s(stage, wanted)
        finally:
            stage.stop()
    if abs(abs(speed) / wanted - 1) > _SPEED_TOLERANCE:
        told = f"turns at {speed:.2f} deg/s instead of {wanted:g}"
        return [*findings, DoctorFinding("stage", "wrong", told, "check its largest velocity, its load and its servo")]
    return [*findings, DoctorFinding("stage", "ok", f"turns at {speed:.3f} deg/s, even to {ripple_deg:.3f} deg")]


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


def _projector(rig: Rig) -> list[DoctorFinding]:
    table = rig.need_projector()
    wanted = (table.settings or ProjectorSettings()).monitor
    monitors = list_monitors()
    chosen = [one for one in monitors if wanted in (one.index, one.name)]
    if not chosen:
        there = "; ".join(map(str, monitors)) or "none"
        raise DeviceError(
            "projector", f"monitor {wanted!r} is not there; found: {there}", "connect it, or name another"
        )
    return monitor_findings(chosen[0], table.columns, table.rows, table.frame_rate_hz) + session_findings()
