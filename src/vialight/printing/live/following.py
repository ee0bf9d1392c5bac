"""The process that renews the live volume: it reads the recording, and hands on what comes of it.

Nobody waits for it.  It reads every frame; each gets a renewal and a snapshot of its own, unless so many wait that it
takes them all into one.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import time
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import numpy as np

from vialight.control.forecast import Forecaster
from vialight.control.stop_model import StopModel
from vialight.core.arrays import TURN_RAD, FloatArray
from vialight.core.config import Rig
from vialight.core.mesh import Mesh
from vialight.core.messages import CameraImage, Snapshot, StopForecast
from vialight.devices.panel import LightPanel
from vialight.printing.live.analysis import region_of
from vialight.printing.live.lit_time import LitTime
from vialight.printing.live.sharing import LiveMoment, SharedVolume
from vialight.printing.live.talking import DONE, FINISH, READY, faults_told_to
from vialight.store import FrameTail, NewFrames
from vialight.system import leave_interrupts_to_the_print
from vialight.system.mailboxes import Mailbox
from vialight.tomography.sliding.window import SlidingWindow, WindowState, compile_kernels

_POLL_S = 0.003
_SECOND_S = 1.0
_RATE_OVER = 50
_ROUNDING = 1e-6
_FEW = 4
"""Frames that may wait before they have to share a renewal."""


@dataclass(frozen=True)
class LiveSettings:
    """What is to be followed, and how.

    Parameters
    ----------
    run
        The run's folder, with ``frames.h5`` and, where light is logged, ``projector.csv``.
    mailboxes
        Folder for ``snapshot``, ``surface`` and ``forecast``.
    rig
        As the frames are recorded.
    threshold
        I_p, counts per mm.
    frames_per_turn
        Virtual angles of the window.
    reference
        What is meant; None to compare with nothing.
    stop_model
        What the forecast of the stop stands on; None for none.
    voxel_mm
        Of the live volume; by default that of a reconstruction.
    every_deg
        Turn of the object between volumes and surfaces that are kept, from the first full turn on; None to keep none.
    """

    run: Path
    mailboxes: Path
    rig: Rig
    threshold: float
    frames_per_turn: int
    reference: Mesh | None = None
    stop_model: StopModel | None = None
    voxel_mm: float | None = None
    every_deg: float | None = 360.0

    def kept_by(self, turned_rad: float) -> int:
        """Return how many volumes are to be kept by the time that the object has turned so far.

        Examples
        --------
        >>> settings = LiveSettings(Path(), Path(), Rig(), 1.0, 180, every_deg=90.0)
        >>> [settings.kept_by(np.deg2rad(turned)) for turned in (0, 359, 360, 449, 450, 720)]
        [0, 0, 1, 1, 2, 5]
        """
        if self.every_deg is None:
            return 0
        every = np.deg2rad(self.every_deg)
        full = int(np.ceil(TURN_RAD / every - _ROUNDING))
        return max(0, int(turned_rad / every + _ROUNDING) - full + 1)


def follow(settings: LiveSettings, orders: Connection[Any, Any]) -> None:
    """Renew the volume with every frame until told to finish, or until the process that prints is gone."""
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(2)
    with faults_told_to(orders):
        _follow(settings, orders)


def _follow(settings: LiveSettings, orders: Connection[Any, Any]) -> None:
    panel = LightPanel(settings.mailboxes)
    tail = FrameTail(settings.run / "frames.h5")
    window = SlidingWindow(
        settings.rig, tail.image_shape, settings.frames_per_turn, dark=tail.dark, threshold=settings.threshold,
        voxel_mm=settings.voxel_mm,
    )  # fmt: skip
    compile_kernels()  # frames wait for it otherwise, for seconds on a busy machine
    follower = _Follower(settings, window)
    parent = multiprocessing.parent_process()
    assert parent is not None
    orders.send_bytes(READY)
    is_finishing = False
    while not wait([parent.sentinel], timeout=0):
        panel.beat("follower")
        new = tail.new()
        if new is not None:
            for frames in shares(new):
                for counts, angle in zip(frames.counts, frames.angles_rad, strict=True):
                    panel.beat("follower")
                    window.add(counts, float(angle))
                follower.renew(frames.first + len(frames.counts), frames.time_s, frames.angles_rad)
        elif is_finishing:
            window.renew(everything=True)  # the last volume is of all that was seen
            follower.show_volume()
            orders.send_bytes(DONE)
            return
        elif orders.poll(_POLL_S):
            is_finishing = orders.recv_bytes() == FINISH


def shares(new: NewFrames) -> Iterator[NewFrames]:
    """Yield what each renewal takes of frames that have come: one each, or all where more than a few wait.

    Examples
    --------
    >>> def sizes(count):
    ...     new = NewFrames(7, np.zeros((count, 2, 3)), np.zeros(count), np.zeros(count))
    ...     return [(part.first, len(part.counts)) for part in shares(new)]
    >>> sizes(2), sizes(9)
    ([(7, 1), (8, 1)], [(7, 9)])
    """
    if len(new.counts) > _FEW:
        yield new
        return
    for k in range(len(new.counts)):
        one = slice(k, k + 1)
        yield NewFrames(new.first + k, new.counts[one], new.angles_rad[one], new.time_s[one])


class _Follower:
    """What the process keeps from one renewal to the next."""

    def __init__(self, settings: LiveSettings, window: SlidingWindow) -> None:
        self._settings, self._window = settings, window
        images = sum(a * b for a, b in _pairs(window.grid.shape)) * 4 * 2
        self._snapshots = Mailbox(settings.mailboxes / "snapshot", Snapshot, images + 2**16)
        self._forecasts = Mailbox(settings.mailboxes / "forecast", StopForecast, 2**14)
        self._camera: Mailbox[CameraImage] | None = None
        self._lit = LitTime(settings.run / "projector.csv")
        self._shared = SharedVolume.make(
            settings.mailboxes / "volume", window.grid, region_of(window.grid, settings.reference)
        )
        window.keep_in(self._shared.whole)
        self._times: deque[float] = deque(maxlen=_RATE_OVER)
        self._forecaster: Forecaster | None = None
        if settings.stop_model is not None:
            self._forecaster = Forecaster(settings.stop_model, window.grid, settings.threshold)
        self._shown_at, self._shown_turned_rad = -np.inf, 0.0
        self._first_rad: float | None = None
        self._newest: tuple[int, float, float] = (0, 0.0, 0.0)

    def renew(self, frames: int, times_s: FloatArray, angles_rad: FloatArray) -> None:
        state = self._window.renew()
        self._times.extend(times_s)
        time_s, angle_rad = float(times_s[-1]), float(angles_rad[-1])
        snapshot = self._snapshot(state, frames, time_s, angle_rad)
        self._snapshots.put(snapshot)
        if self._first_rad is None:
            self._first_rad = float(angles_rad[0])
        turned = abs(angle_rad - self._first_rad)
        self._newest = (frames, time_s, turned)
        self._foresee(time_s)
        kept_by = self._settings.kept_by
        is_wanted = kept_by(turned) > kept_by(self._shown_turned_rad)
        if (is_wanted or time.monotonic() - self._shown_at >= _SECOND_S) and self._shared.is_free():
            self.show_volume()

    def show_volume(self) -> None:
        """Let the process that measures it look at the volume."""
        frames, time_s, turned_rad = self._newest
        if frames and self._shared.wait_until_free(_SECOND_S):
            self._shared.tell(LiveMoment(frames, time_s, self._lit.at(time_s), turned_rad))
            self._shown_at, self._shown_turned_rad = time.monotonic(), turned_rad

    def _snapshot(self, state: WindowState, frames: int, time_s: float, angle_rad: float) -> Snapshot:
        span = self._times[-1] - self._times[0]
        return Snapshot(
            frames=frames, time_s=time_s, angle_deg=float(np.rad2deg(angle_rad)), latency_s=self._latency(frames),
            frame_rate_hz=(len(self._times) - 1) / span if span > 0 else 0.0, voxel_mm=self._window.grid.voxel_mm,
            centre_z_mm=self._window.grid.centre_z_mm, density=state.density, cured=state.cured,
            cured_volume_mm3=state.cured_volume_mm3, provisional_share=state.provisional_share,
        )  # fmt: skip

    def _latency(self, frames: int) -> float:
        """Return the wall time since the newest frame used arrived; NaN where that is not known."""
        if self._camera is None and (self._settings.mailboxes / "camera").exists():
            self._camera = Mailbox(self._settings.mailboxes / "camera", CameraImage)
        newest = self._camera.newest() if self._camera is not None else None
        if newest is None:
            return float("nan")
        return time.monotonic() - newest[1].arrival_of(frames - 1)

    def _foresee(self, time_s: float) -> None:
        if self._forecaster is None:
            return
        forecast = self._forecaster.add(self._window.volume, self._lit.at(time_s))
        if forecast is not None:
            self._forecasts.put(forecast)


def _pairs(shape: tuple[int, int, int]) -> tuple[tuple[int, int], ...]:
    z, y, x = shape
    return (y, x), (z, x), (z, y)
