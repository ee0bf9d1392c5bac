"""The process that measures the live volume about once a second, and keeps what a print looked like over time."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

import numpy as np

from vialight.core.arrays import Float32Array, Volume
from vialight.core.errors import InputError
from vialight.core.messages import Snapshot, StopForecast, SurfaceSnapshot
from vialight.devices.panel import LightPanel
from vialight.printing.live.analysis import (
    GelTimeMap,
    Measured,
    coarsened,
    measure,
    measured_grid,
    middle_slices,
    yardstick,
)
from vialight.printing.live.following import LiveSettings
from vialight.printing.live.sharing import LiveMoment, SharedVolume
from vialight.printing.live.talking import DONE, FINISH, READY, faults_told_to
from vialight.store import SERIES, VolumeSeriesWriter, write_history, write_ply
from vialight.system import leave_interrupts_to_the_print, wait_for
from vialight.system.mailboxes import Mailbox

_LARGEST_SURFACE = 64 * 2**20
_WAIT_S = 0.2
_START_S = 60.0


def analyse(settings: LiveSettings, orders: Connection[Any, Any]) -> None:
    """Measure whatever volume is given until told to finish, or until the process that prints is gone."""
    leave_interrupts_to_the_print()
    with contextlib.suppress(OSError, AttributeError):
        os.nice(17)
    with faults_told_to(orders):
        _analyse(settings, orders)


def _analyse(settings: LiveSettings, orders: Connection[Any, Any]) -> None:
    panel, path = LightPanel(settings.mailboxes), settings.mailboxes / "volume"
    if wait_for(path.exists, timeout_s=_START_S) is not None:
        return
    analyst = _Analyst(settings, SharedVolume(path))
    orders.send_bytes(READY)
    parent = multiprocessing.parent_process()
    assert parent is not None
    is_finishing = False
    while not wait([parent.sentinel], timeout=0):
        panel.beat("analyst")
        if analyst.measure_next():
            continue
        if is_finishing:
            analyst.finish()
            orders.send_bytes(DONE)
            return
        if orders.poll():
            is_finishing = orders.recv_bytes() == FINISH


class _Seen(NamedTuple):
    """When the volume was looked at, and what was found."""

    moment: LiveMoment
    found: Measured


class _Analyst:
    """What the process keeps from one volume to the next."""

    def __init__(self, settings: LiveSettings, shared: SharedVolume) -> None:
        self._settings, self._shared = settings, shared
        self._surfaces = Mailbox(settings.mailboxes / "surface", SurfaceSnapshot, _LARGEST_SURFACE)
        # Made by the other process before it tells of the first volume.
        self._snapshots = Mailbox(settings.mailboxes / "snapshot", Snapshot)
        self._forecasts = Mailbox(settings.mailboxes / "forecast", StopForecast)
        self._grid = measured_grid(shared.grid)
        self._against = None if settings.reference is None else yardstick(settings.reference, self._grid)
        self._gel_times = GelTimeMap(shared.grid.shape)
        self._series: VolumeSeriesWriter | None = None
        if settings.every_deg is not None:
            with contextlib.suppress(InputError):  # as in `measure_next`
                self._series = VolumeSeriesWriter(settings.run / SERIES, shared.grid, {"threshold": settings.threshold})
        turned = [] if self._series is None else self._series.moments.get("turned_deg", [])
        self._kept = settings.kept_by(np.deg2rad(turned[-1])) if turned else 0
        self._last: _Seen | None = None
        (settings.run / "surfaces").mkdir(exist_ok=True)

    def measure_next(self) -> bool:
        """Measure the next volume; False where none came."""
        moment = self._shared.wait_for_moment(_WAIT_S)
        if moment is None:
            return False
        density = self._shared.density
        # Copies: the other process changes the volume meanwhile.
        due = self._settings.kept_by(moment.turned_rad)
        whole = density.copy(order="K") if due > self._kept else None
        volume = coarsened(Volume(density, self._shared.grid), self._grid)
        if moment.lit_s > 0:
            self._gel_times.note(density, self._settings.threshold, moment.lit_s)
        self._last = seen = _Seen(moment, measure(volume, self._settings.threshold, self._against))
        told = self._told(seen)
        self._surfaces.put(told)
        with contextlib.suppress(InputError):  # a full disk: the recorder tells; what is shown needs no disk
            self._keep(told)
            if whole is not None:
                self._kept = due
                self._keep_whole(seen, whole)
        self._shared.done()
        return True

    def finish(self) -> None:
        """Keep what only the end knows, and what the print has come to."""
        kept_s = [-np.inf] if self._series is None else self._series.moments.get("time_s", [-np.inf])
        if self._last is not None and self._last.moment.time_s > kept_s[-1]:
            with contextlib.suppress(InputError):
                self._keep_whole(self._last, self._shared.density)
        np.save(self._settings.run / "gel_time_s.npy", self._gel_times.lit_s)

    def _told(self, seen: _Seen) -> SurfaceSnapshot:
        (moment, found), density = seen, self._shared.density
        forecast = self._forecasts.newest()
        surface = found.surface
        return SurfaceSnapshot(
            frames=moment.frames, time_s=moment.time_s, lit_s=moment.lit_s,
            vertices_mm=np.empty((0, 3), np.float32) if surface is None else surface.vertices_mm.astype(np.float32),
            faces=np.empty((0, 3), np.int32) if surface is None else surface.faces.astype(np.int32),
            deviation_mm=found.deviation_mm, rmse_mm=found.rmse_mm, reverse_rmse_mm=found.reverse_rmse_mm,
            iou=found.iou, cured_volume_mm3=float(np.count_nonzero(density >= self._settings.threshold))
            * self._shared.grid.voxel_mm**3,
            slices=middle_slices(density), gel_time_s=self._gel_times.means(),
            forecast=None if forecast is None else forecast[1],
        )  # fmt: skip

    def _keep(self, told: SurfaceSnapshot) -> None:
        """Add to the history."""
        newest = self._snapshots.newest()
        if newest is not None:
            write_history(self._settings.run, newest[1], told)

    def _keep_whole(self, seen: _Seen, density: Float32Array) -> None:
        """Keep a (z, y, x) volume and its surface."""
        if self._series is None:
            return
        moment, surface = seen.moment, seen.found.surface
        self._series.append(
            density, time_s=moment.time_s, lit_s=moment.lit_s, frame=moment.frames - 1,
            turned_deg=float(np.rad2deg(moment.turned_rad)),
        )  # fmt: skip
        if surface is not None:
            scalars = {"deviation_mm": seen.found.deviation_mm} if len(seen.found.deviation_mm) else {}
            write_ply(self._settings.run / "surfaces" / f"{moment.frames - 1:06d}.ply", surface, scalars)
