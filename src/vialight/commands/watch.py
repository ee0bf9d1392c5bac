"""Replay a recording as if it were live."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from vialight.commands.print_job import LiveOptions
from vialight.core.arrays import TURN_RAD
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.messages import CameraImage, PrintStatus, Snapshot, SurfaceSnapshot
from vialight.devices import DeviceError, SimulatedClock
from vialight.devices.replay import ReplayCamera, ReplayStage
from vialight.optics.viewing import columns_and_directions
from vialight.printing.live.following import LiveSettings
from vialight.printing.live.watcher import LiveWatcher
from vialight.printing.live_link import LiveLink
from vialight.printing.log import EventLog
from vialight.printing.recorder import Recorder
from vialight.store import FrameWriter, open_frames
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.system import check_plain, file_in, scratch_folder, shared_folder, wait_for
from vialight.system.mailboxes import Mailbox
from vialight.tomography.sinogram import frames_a_turn
from vialight.web import PageProcess

_TICK_S = 0.02
_START_S = 30.0
"""In which the first frame is on the disk."""
_READY_S = 180.0
"""In which the live measurement is ready, and in which it has seen the last frame."""
_TAKEN_ALONG = ("rig.toml", "reference.stl", "plan.h5", "run.json", "projector.csv", "log.jsonl")
_LARGEST_TAKEN_BYTES = 2_000_000_000


def watch_run(
    run: str | Path,
    *,
    rate: float = 1.0,
    out: str | Path | None = None,
    threshold: float | None = None,
    voxel_mm: float | None = None,
    every_deg: float = 360.0,
    serve: bool = False,
    keep_going: Callable[[], bool] = lambda: True,
    on_status: Callable[[PrintStatus], None] = lambda status: None,
    on_step: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Replay the recording of a run as if it were live.

    Parameters
    ----------
    run
        A run's folder with ``frames.h5`` and ``rig.toml``; of a finished print, a dead one, or a simulated one.
    rate
        Times real time.
    out
        Folder for what is measured on the way, as a print keeps it: volumes, surfaces, history; by default none is.
    threshold, voxel_mm, every_deg
        See `vialight.commands.print_job.LiveOptions`.
    serve
        Show it in a browser.
    keep_going
        Asked all the time; False ends the replay.
    on_status, on_step
        Told how it is doing.

    Returns
    -------
    dict
        How late snapshots were, from a frame's arrival, and what was seen at the end.

    Raises
    ------
    InputError
        The run cannot be read, or `out` holds something already.
    DeviceError
        The disk refuses what is recorded anew, or a process that measures has ended.
    """
    run = Path(run)
    rig, recording = load_rig(file_in(run, "rig.toml")), file_in(run, "frames.h5")
    LiveOptions(every_deg=every_deg)
    if threshold is None:
        with open_frames(recording) as frames:
            threshold = rig.need_threshold(rig.imaged_under(frames.settings))
    if not (np.isfinite(rate) and 0.01 <= rate <= 100):
        raise InputError("--rate", f"is {rate}", accepted="0.01 to 100")
    with _folder(out) as folder, _removed_afterwards(shared_folder()) as boxes:
        for name in _TAKEN_ALONG:
            if (given := file_in(run, name)).exists():
                check_plain(given, _LARGEST_TAKEN_BYTES)
                shutil.copyfile(given, folder / name)
        clock = SimulatedClock(boxes / "clock", rate)
        camera = ReplayCamera(recording, clock)
        settings = LiveSettings(
            folder, boxes, rig, threshold, frames_a_turn(camera.angles_rad),
            load_mesh(part) if (part := file_in(run, "reference.stl")).exists() else None, voxel_mm=voxel_mm,
            every_deg=None if out is None else every_deg,
        )  # fmt: skip
        replay = _Replay(run, folder, boxes, camera, clock, LiveWatcher(settings))
        with contextlib.closing(camera), replay, contextlib.ExitStack() as stack:
            LiveLink.of_this_process(boxes).publish(folder)
            if serve:
                page = stack.enter_context(PageProcess(folder))
                on_step(f"open {page.link}")
            replay.play(keep_going, on_status)
        return replay.record() | _refraction_delays(rig)


class _Replay:
    """Records anew what comes from a recording, and follows how it is watched."""

    def __init__(
        self, run: Path, folder: Path, boxes: Path, camera: ReplayCamera, clock: SimulatedClock, watcher: LiveWatcher
    ) -> None:
        self._camera, self._clock, self._watcher, self._folder = camera, clock, watcher, folder
        self._stage = ReplayStage(camera, clock)
        self._camera_box = Mailbox(boxes / "camera", CameraImage, 2**16 + 2 * int(np.prod(camera.image_shape)))
        self._status_box = Mailbox(boxes / "status", PrintStatus, 2**16)
        self._snapshot_box: Mailbox[Snapshot] | None = None
        self._boxes = boxes
        rate_hz = (camera.count - 1) / max(float(np.ptp(camera.times_s)), 1e-9) if camera.count > 1 else 10.0
        self._log = EventLog(folder / "replay.jsonl", clock)
        self._recorder = Recorder(camera, clock, rate_hz, self._stage.angle_at, self._log, self._show_frame)
        with open_frames(file_in(run, "frames.h5")) as frames:
            dark = frames.dark()
        self._writer = FrameWriter(
            folder / "frames.h5", camera.image_shape,
            dark=None if dark is None else np.rint(dark).astype(np.uint16),
        )  # fmt: skip
        self._arrived_s: dict[int, float] = {}
        self._latencies: list[float] = []
        self._seen = self._number = 0
        self._told_at = 0.0
        self._last: SurfaceSnapshot | None = None
        self._skipped = self._surfaces = 0

    def __enter__(self) -> _Replay:
        return self

    def __exit__(self, *ended: object) -> None:
        self._recorder.close()
        self._watcher.close()
        self._log.close()
        LiveLink.withdraw(self._folder)

    def play(self, keep_going: Callable[[], bool], on_status: Callable[[PrintStatus], None]) -> None:
        """Hand out every frame at its time; time stands still after the first until the watcher follows."""
        self._recorder.write_to(self._writer)
        self._camera.start(0.0)
        self._recorder.start()
        if not self._comes(keep_going, lambda: self._recorder.written > 0, "its first frame", _START_S):
            return
        self._watcher.start()
        if not self._comes(keep_going, self._watcher.is_ready, "the live measurement", _READY_S):
            return
        self._clock.allow_until(float("inf"))

        def look() -> None:
            self._look()
            if time.monotonic() - self._told_at > 10 * _TICK_S:
                self._told_at = time.monotonic()
                on_status(self._publish())

        lasts_s = (float(np.ptp(self._camera.times_s)) + 1) / self._clock.rate
        self._comes(keep_going, lambda: self._camera.is_over, "the last frame", 2 * lasts_s + _READY_S, look)
        self._comes(keep_going, self._has_caught_up, "the last snapshot", _READY_S, look)
        if (surfaces := self._boxes / "surface").exists():
            with Mailbox(surfaces, SurfaceSnapshot) as box:
                self._surfaces, self._last = box.newest() or (0, None)

    def _has_caught_up(self) -> bool:
        # Frames that were refused or lost never come to be seen, and all others are in the file before they are.
        taken = self._recorder.written + self._recorder.refused + self._recorder.lost
        return taken >= self._camera.count and self._seen >= self._recorder.written

    def _comes(
        self, keep_going: Callable[[], bool], condition: Callable[[], bool], what: str, timeout_s: float,
        look: Callable[[], None] = lambda: None,
    ) -> bool:  # fmt: skip
        """Wait for something; say whether to go on.

        Raises
        ------
        DeviceError
            It does not come, since the disk refuses or a process has ended, or within the time.
        """

        def fault() -> str | None:
            if told := self._recorder.disk_fault():
                return f"disk: {told}"
            return self._watcher.fault() if self._watcher.has_ended() else None

        told = wait_for(lambda: condition() or not keep_going(), fault, timeout_s, tick=look, every_s=_TICK_S / 4)
        if told is not None:
            raise DeviceError("replay", f"{what} does not come: {told}", f"{self._recorder.written} frames were seen")
        return keep_going()

    def _look(self) -> None:
        if self._snapshot_box is None:
            if not (self._boxes / "snapshot").exists():
                return
            self._snapshot_box = Mailbox(self._boxes / "snapshot", Snapshot)
        found = self._snapshot_box.newest(after=self._number)
        if found is None:
            return
        self._number, snapshot = found
        if snapshot.frames > self._seen:
            self._skipped += snapshot.frames - self._seen - 1
            self._seen = snapshot.frames
            arrived_s = self._arrived_s.get(snapshot.frames - 1)
            if arrived_s is not None:  # told a moment after the file has it
                self._latencies.append(time.monotonic() - arrived_s)

    def _show_frame(self, image: CameraImage) -> None:
        self._arrived_s[image.frame] = image.arrived_monotonic_s
        with contextlib.suppress(InputError):  # no memory left to show it
            self._camera_box.put(image)

    def _publish(self) -> PrintStatus:
        clock_s, began_s = self._clock.now_s(), self._camera.started_s
        now, turned = clock_s - began_s, self._stage.angle_at(clock_s) - self._stage.angle_at(began_s)
        status = PrintStatus(
            state="replay", message="a recording, replayed", time_s=now, lit_s=0.0,
            turn=abs(turned) / TURN_RAD,
            remaining_s=max(0.0, float(self._camera.times_s[-1]) - now), mode="manual",
            frames=self._recorder.written, missed=0, disk_free_bytes=shutil.disk_usage(self._folder).free,
            disk_left_s=float("inf"), pattern=None, devices={"live": self._watcher.fault() or "ok"},
        )  # fmt: skip
        with contextlib.suppress(InputError):
            self._status_box.put(status)
        return status

    def record(self) -> dict[str, Any]:
        """Return how late snapshots were, and what was seen at the end."""
        late, last = np.array(self._latencies), self._last
        return {
            "frames": self._recorder.written,
            "snapshots": len(self._latencies),
            "surfaces": self._surfaces,
            "frames_without_snapshot": self._skipped,
            "latency_p50_s": float(np.percentile(late, 50)) if len(late) else float("nan"),
            "latency_p95_s": float(np.percentile(late, 95)) if len(late) else float("nan"),
            "rmse_mm": None if last is None else last.rmse_mm,
            "reverse_rmse_mm": None if last is None else last.reverse_rmse_mm,
            "iou": None if last is None else last.iou,
        }  # fmt: skip


def _refraction_delays(rig: Rig) -> dict[str, float]:
    """Return how much later than on the axis rays at half of the field, and at its edge, are complete, s."""
    optics = rig.imaging_optics()
    if optics is None:
        return {"refraction_delay_half_field_s": 0.0, "refraction_delay_edge_s": 0.0}
    reach = np.array([0.5, 0.999]) * optics.field_radius_mm
    _, direction = columns_and_directions(reach, 0.0, rig.need_camera(), optics)
    half, edge = np.abs(np.rad2deg(direction)) / rig.stage.speed_deg_s
    return {"refraction_delay_half_field_s": float(half), "refraction_delay_edge_s": float(edge)}


@contextlib.contextmanager
def _folder(out: str | Path | None) -> Iterator[Path]:
    if out is None:
        with _removed_afterwards(scratch_folder()) as made:
            yield made
        return
    folder = Path(out)
    if folder.exists() and any(folder.iterdir()):
        raise InputError(out, "holds something already", accepted="a new folder", remedy="choose another name")
    folder.mkdir(exist_ok=True)
    yield folder


@contextlib.contextmanager
def _removed_afterwards(folder: Path) -> Iterator[Path]:
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
