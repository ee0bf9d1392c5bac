"""Calibrate delays: of the camera against the stage, and of the projector against both."""

from __future__ import annotations

import math
import os
import random
import shutil
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from vialight.calibration.findings import Finding, Findings
from vialight.calibration.latency.estimator import Found, Turn, delay_between_camera_and_stage, delay_of_flashes
from vialight.calibration.writing import Calibrated, check_out
from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.config import CameraSettings, Rig, StageSettings
from vialight.core.errors import InputError
from vialight.devices import LEASE_S, Camera, Clock, DeviceTimeoutError, Lease, LightPhase, MonotonicClock, Projector
from vialight.devices.opening import open_camera
from vialight.devices.projectors import open_projector
from vialight.store import open_frames
from vialight.store.rig_files import load_rig
from vialight.system import shared_folder

_FLASHES = 12
_LIT_S, _DARK_S = 0.5, 0.5
_FRAME_RATE_HZ = 10.0
_POLL_S = 0.02
_BANDS = 64
"""Of rows, and of columns, to which a frame is reduced."""


def calibrate_latency(
    first: str | Path, second: str | Path, rig_path: str | Path, out: str | Path, *, flash: bool = False,
    on_step: Callable[[str], None] = lambda message: None,
) -> Calibrated:  # fmt: skip
    """Find the delays of camera and projector.

    Parameters
    ----------
    first, second
        Recordings of one thing that turns, at two speeds or both ways round, taken with the rig as it is.
    rig_path
        The rig to change.
    out
        The new rig.
    flash
        Flash the projector that the rig names, and see it with its camera, for the projector's delay.
    on_step
        Told in words what is done.

    Returns
    -------
    Calibrated
        The new rig, to be written.

    Raises
    ------
    InputError
        The recordings cannot be used, or `out` cannot be written.
    DeviceError
        Camera or projector fails.
    """
    check_out(rig_path, out)
    rig = load_rig(rig_path)
    late = delay_between_camera_and_stage(_turn_in(first), _turn_in(second))
    seen = None
    if flash:
        on_step("flashing the projector")
        seen = _flashes_of(rig)
    return Calibrated(_findings(rig, late, seen), rig_path, first, out, inputs={"second": second})


def watch_flashes(
    camera: Camera, projector: Projector, clock: Clock, *, count: int = _FLASHES
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Flash a projector unevenly; return times and means of the frames, and from when to when there was light."""
    uneven = random.Random(0)
    times: list[float] = []
    means: list[float] = []

    def look(until_s: float, *, is_lit: bool) -> float:
        """Take frames up to a time; return since when the projector shows what it is to show."""
        while clock.now_s() < until_s:
            if is_lit:
                projector.renew(Lease(LightPhase.LIT, time.monotonic() + LEASE_S, 0.0, clock.now_s(), 0.0, math.inf))
            try:
                frame = camera.next_frame(_POLL_S)
            except DeviceTimeoutError:
                continue
            times.append(frame.time_s)
            means.append(float(frame.counts.mean()))
        return projector.shown().since_s

    camera.start(_FRAME_RATE_HZ)
    flashes = []
    look(clock.now_s() + 2 * _DARK_S, is_lit=False)
    for _ in range(count):
        on = look(clock.now_s() + _LIT_S + uneven.uniform(0.0, 1 / _FRAME_RATE_HZ), is_lit=True)
        projector.darken()
        off = look(clock.now_s() + _DARK_S + uneven.uniform(0.0, 1 / _FRAME_RATE_HZ), is_lit=False)
        flashes.append((on, off))
    return np.array(times), np.array(means), np.array(flashes)


def _flashes_of(rig: Rig) -> Found:
    clock, folder = MonotonicClock(), shared_folder()
    settings = rig.need_camera().settings or CameraSettings()
    if settings.exposure_s is None:
        raise InputError(f"{rig.source} [camera.settings]", "has no exposure_s", accepted="seconds", remedy="add it")
    try:
        camera = open_camera(rig, clock)
        try:
            projector = open_projector(
                rig.need_projector(), clock, None, np.zeros(1), Path(rig.source).parent, folder, Path(os.devnull)
            )
            try:
                times, means, flashes = watch_flashes(camera, projector, clock)
            finally:
                projector.close()
        finally:
            camera.close()
    finally:
        shutil.rmtree(folder, ignore_errors=True)
    return delay_of_flashes(times, means, settings.exposure_s, flashes)


def _findings(rig: Rig, late: Found, seen: Found | None) -> Findings:
    """Say what the rig gets: the camera takes the difference to the stage, the stage what would be below zero."""
    camera_s = (rig.need_camera().settings or CameraSettings()).latency_s + late.value
    stage_s = (rig.stage.settings or StageSettings()).latency_s
    shift_s = max(0.0, -camera_s)
    values = [
        Finding("camera.settings", "latency_s", camera_s + shift_s, late.uncertainty, "angles in both turns agree"),
        Finding("stage.settings", "latency_s", stage_s + shift_s, None, "only its difference to the camera's is known"),
    ]
    notes = [f"frames had the angle of {1000 * late.value:+.1f} ms later"]
    if seen is None:
        notes.append("the projector was left alone: --flash finds its delay too")
    else:
        values.append(
            Finding("projector.settings", "latency_s", max(0.0, seen.value - late.value - shift_s),
                    math.hypot(seen.uncertainty, late.uncertainty), "flashes are seen when they are shown")
        )  # fmt: skip
        notes.append(f"flashes were seen {1000 * seen.value:+.1f} ms after they were shown")
    return Findings(
        "latency", "one thing turned at two speeds" + ("" if seen is None else ", and flashes"), values, notes
    )


def _turn_in(path: str | Path) -> Turn:
    """Read the first turn of a recording, its frames reduced to bands of rows and columns."""
    with open_frames(path) as frames:
        if frames.time_s is None:
            raise InputError(f"{path} /exchange/time", "is missing", accepted="seconds, one a frame")
        turned = np.abs(np.unwrap(frames.angles_rad) - frames.angles_rad[0])
        count = min(int(np.searchsorted(turned, TURN_RAD)) + 1, frames.shape[0])
        _, rows, columns = frames.shape
        row_edges, column_edges = (np.unique(np.linspace(0, size, min(size, _BANDS) + 1).astype(int)[:-1])
                                   for size in (rows, columns))  # fmt: skip
        images = []
        for number in range(count):
            image = frames.read(slice(number, number + 1))[0].astype(np.float64)
            banded = np.add.reduceat(np.add.reduceat(image, row_edges, axis=0), column_edges, axis=1)
            images.append(banded.ravel())
        return Turn(np.array(images), frames.angles_rad[:count], frames.time_s[:count])
