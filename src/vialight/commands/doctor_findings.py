"""What the doctor makes of what instruments have done, in plain words: judgements alone, no device."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vialight.core.config import Camera as CameraTable
from vialight.devices import CameraFrame, DeviceError
from vialight.devices.projectors import Monitor, check_size

WATCHED_S = 3.0
"""For which frames are looked at."""
_RATE_TOLERANCE = 0.02
_JITTER_DEG = 0.1
"""By which a frame's angle may be wrong: at the edge of the field a fifth of a pixel of the paper's camera."""
_SATURATED, _SATURATED_SHARE = 0.98, 1e-4
_BLACK = 0.01
"""Of the full level: an image that nowhere reaches it shows nothing."""


@dataclass(frozen=True)
class DoctorFinding:
    """What was found of a device."""

    device: str
    state: Literal["ok", "note", "wrong"]
    told: str
    remedy: str = ""


def image_findings(table: CameraTable, image_shape: tuple[int, int]) -> list[DoctorFinding]:
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
            told = f"{key} {position:g} lies outside the image of {size_words(image_shape)} pixels"
            findings.append(
                DoctorFinding("camera", "wrong", told, "correct it, or region and binning in [camera.settings]")
            )
    return findings


def frame_findings(
    frames: list[CameraFrame], frame_rate_hz: float, full_level: int, speed_deg_s: float
) -> list[DoctorFinding]:
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
        return [DoctorFinding("camera", "wrong", f"sent {len(frames)} frames in {WATCHED_S:g} s", remedy)]
    findings = []
    numbers = np.array([frame.number for frame in frames], dtype=np.float64)
    times = np.array([frame.time_s for frame in frames])
    lost = int(numbers.max() - numbers.min()) + 1 - len(frames)
    if lost > 0:
        remedy = "network or USB is too slow, or the machine too busy; a smaller region or fewer bits a pixel need less"
        findings.append(DoctorFinding("camera", "wrong", f"{lost} of {lost + len(frames)} frames were lost", remedy))
    period_s, begin_s = np.polyfit(numbers, times, 1)
    if abs(period_s * frame_rate_hz - 1) > _RATE_TOLERANCE:
        told = f"sends {1 / period_s:.4g} frames/s instead of {frame_rate_hz:g}"
        findings.append(DoctorFinding("camera", "wrong", told, "shorten the exposure; check the trigger's rate"))
    jitter_s = float(np.abs(times - begin_s - period_s * numbers).max())
    if jitter_s * speed_deg_s > _JITTER_DEG:
        told = f"times of frames are off by up to {1e3 * jitter_s:.1f} ms, {jitter_s * speed_deg_s:.2f} deg of turn"
        findings.append(
            DoctorFinding("camera", "wrong", told, "the camera has no clock of its own, or the machine is busy")
        )
    findings += _brightness(frames[-1], full_level)
    if not findings:
        told = f"{len(frames)} frames at {1 / period_s:.4g}/s, none lost, times even to {1e3 * jitter_s:.2f} ms"
        findings.append(DoctorFinding("camera", "ok", told))
    return findings


def _brightness(frame: CameraFrame, full_level: int) -> list[DoctorFinding]:
    share = float((frame.counts >= _SATURATED * full_level).mean())
    if share > _SATURATED_SHARE:
        told = f"{100 * share:.3g} % of the pixels are saturated at {full_level} counts"
        return [DoctorFinding("camera", "wrong", told, "shorten exposure_s or lower gain_db or the light")]
    if (most := int(frame.counts.max())) < _BLACK * full_level:
        told = f"the image is black: at most {most} of {full_level} counts"
        return [
            DoctorFinding("camera", "wrong", told, "take off the lens cap, switch the light on, lengthen exposure_s")
        ]
    return []


def monitor_findings(monitor: Monitor, columns: int, rows: int, frame_rate_hz: float) -> list[DoctorFinding]:
    """Compare a monitor with the projector of a rig.

    Examples
    --------
    >>> [one.told for one in monitor_findings(Monitor(1, "DLP", 1280, 800, 60), 1280, 800, 32.0)]
    ['monitor 1: DLP, 1280 x 800 at 60 Hz']
    """
    try:
        check_size(monitor, (columns, rows))
    except DeviceError as error:
        return [DoctorFinding("projector", "wrong", str(error))]
    if monitor.refresh_hz < frame_rate_hz:
        told = f"monitor {monitor} is slower than frame_rate_hz {frame_rate_hz:g}"
        return [DoctorFinding("projector", "wrong", told, "choose a quicker mode, or lower frame_rate_hz")]
    return [DoctorFinding("projector", "ok", f"monitor {monitor}")]


def session_findings() -> list[DoctorFinding]:
    """Say where the graphical session may change the image unseen."""
    if not os.environ.get("WAYLAND_DISPLAY"):
        return []
    told = "the window is shown through XWayland, and the compositor may scale it without saying so"
    return [DoctorFinding("projector", "note", told, "log in to an X11 session for printing")]


def size_words(image_shape: tuple[int, int]) -> str:
    """Say how large an image is, columns first.

    Examples
    --------
    >>> size_words((300, 480))
    '480 x 300'
    """
    return f"{image_shape[1]} x {image_shape[0]}"
