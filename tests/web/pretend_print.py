"""A print that is only pretended: it publishes, records and obeys as a real one does, and computes nothing.

The part is a torus that grows; 10 snapshots and one surface a second, of whatever size is asked for.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import trimesh
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, Grid, Volume
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.messages import CameraImage, PrintStatus, Snapshot, StopForecast, Sums, SurfaceSnapshot
from vialight.core.plan import Patterns, Plan
from vialight.devices.panel import LightPanel
from vialight.printing.live.analysis import region_of
from vialight.printing.live.sharing import LiveMoment, SharedVolume
from vialight.printing.live_link import LiveLink
from vialight.printing.order_channel import ControlServer
from vialight.report import deviation_colours
from vialight.store import (
    FrameWriter,
    rig_to_toml,
    write_history,
    write_json,
    write_plan,
    write_ply,
    write_stl,
    write_volume,
)
from vialight.system import shared_folder
from vialight.system.mailboxes import Mailbox
from vialight.web.reference import ViewGrid, reference_sums

RIG = Rig.model_validate(
    {
        "vial": {"outer_radius_mm": 12.7, "wall_mm": 1.0, "wall_index": 1.5},
        "resin": {"name": "pretended", "index_imaging": 1.48, "index_writing": 1.49, "threshold": 100.0},
        "camera": {"distance_mm": 145.0, "pixel_mm": 0.06, "axis_column": 241.0, "optical_row": 149.5},
        "projector": {
            "distance_mm": 200.0, "pixel_mm": 0.08, "columns": 320, "rows": 240, "axis_column": 159.5,
            "azimuth_deg": -90.0,
        },
        "stage": {"speed_deg_s": 20.0},
    }
)  # fmt: skip
RING_MM, TUBE_MM = 4.6, 2.0
VOLUME_GRID = Grid((40, 60, 60), 0.25, 1.0)
_LIT_FROM_S = 1.0
"""On the pretended print's clock."""


@dataclass(frozen=True)
class Pretence:
    """How large and how fast."""

    size: int = 120
    """Columns and rows of the overhead images; 480 is a real one's."""
    vertices: int = 5_000
    rate_hz: float = 10.0
    grows_for_s: float = 60.0
    part: str = "ring.stl"
    with_surfaces: bool = True
    after_s: float = 0.6
    """From the light's end to the end of the print."""


def ring(vertices: int) -> Mesh:
    around = int(np.sqrt(vertices * 1.25))
    made = trimesh.creation.torus(RING_MM, TUBE_MM, major_sections=around, minor_sections=vertices // around)
    return Mesh(made.vertices, made.faces)


def grown(reference: Mesh, share: float) -> tuple[Float32Array, Float32Array]:
    """Return the ring's vertices when its tube has grown so far, with ripples, and their true deviations."""
    points = reference.vertices_mm
    middle = points * [1, 1, 0]
    middle *= RING_MM / np.maximum(np.linalg.norm(middle, axis=1, keepdims=True), 1e-9)
    ripple = 0.04 * np.sin(9 * np.arctan2(points[:, 1], points[:, 0]))
    deviation = (share - 1) * TUBE_MM + ripple
    moved = middle + (points - middle) * (1 + deviation / TUBE_MM)[:, None]
    return moved.astype(np.float32), deviation.astype(np.float32)


def volume() -> Volume:
    """Return a density that tells its own place: x + 10 y + 100 z, in mm, and 2000 more, so that none is negative."""
    z, y, x = np.meshgrid(VOLUME_GRID.z_mm, VOLUME_GRID.y_mm, VOLUME_GRID.x_mm, indexing="ij")
    return Volume((2000 + x + 10 * y + 100 * z).astype(np.float32), VOLUME_GRID)


class PretendPrint:
    """Runs in this process until it is left, or stopped by an order."""

    def __init__(self, run: Path, pretence: Pretence | None = None) -> None:
        self.run, self.pretence = run, pretence or Pretence()
        run.mkdir(exist_ok=True)
        (run / "surfaces").mkdir(exist_ok=True)
        self.reference = ring(self.pretence.vertices)
        self.began = time.time()
        self.turns_more = 0.0
        self.mode = "auto"
        self.stopped_s: float | None = None
        self.orders: list[dict[str, Any]] = []
        self.over = threading.Event()
        self.paused: set[str] = set()
        """Which of status, snapshot, surface are held back, as by a process that hangs."""
        self._write_inputs()
        self._sums = self._reference_sums()
        self.began = time.time()
        self.note("began")

    def __enter__(self) -> Self:
        self._folder = shared_folder()
        size = self.pretence.size
        room = {
            "status": 10_000, "camera": 400_000, "snapshot": 2 * 4 * 3 * size * size + 10_000,
            "surface": 64 * self.pretence.vertices + 2 * 4 * 3 * size * size + 10_000,
        }  # fmt: skip
        kinds: dict[str, Any] = {
            "status": PrintStatus, "camera": CameraImage, "snapshot": Snapshot, "surface": SurfaceSnapshot,
        }  # fmt: skip
        self._boxes: dict[str, Mailbox[Any]] = {
            name: Mailbox(self._folder / name, kinds[name], bytes_) for name, bytes_ in room.items()
        }
        self._panel = LightPanel(self._folder, is_new=True)
        shared = SharedVolume.make(self._folder / "volume", VOLUME_GRID, region_of(VOLUME_GRID, None))
        shared.density[...] = volume().density
        shared.tell(LiveMoment(180, 18.0, 0.0, 0.0))
        self._frames = FrameWriter(self.run / "frames.h5", (300, 480))
        (self.run / "projector.csv").write_text("refresh_s,shown_s,due,shown\n")
        self._control = ControlServer(self._folder, self._obey)
        LiveLink.of_this_process(self._folder, self._control.key, self._control.port).publish(self.run)
        self._threads = [
            threading.Thread(target=self._repeat, args=(name, interval, act), daemon=True)
            for name, interval, act in (
                ("status", 0.04, self._tell_status),
                ("snapshot", 1 / self.pretence.rate_hz, self._tell_snapshot),
                ("surface", 1.0, self._tell_surface),
            )
        ]  # fmt: skip
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.over.set()
        for thread in self._threads:
            thread.join()
        LiveLink.withdraw(self.run)
        self._frames.close()
        self._control.close()
        for box in self._boxes.values():
            box.close()
        shutil.rmtree(self._folder, ignore_errors=True)

    @property
    def now_s(self) -> float:
        return time.time() - self.began

    @property
    def lit_s(self) -> float:
        end = self.now_s if self.stopped_s is None else self.stopped_s
        return max(end - _LIT_FROM_S, 0.0)

    @property
    def is_lit(self) -> bool:
        return self.stopped_s is None and self.now_s >= _LIT_FROM_S

    @property
    def share(self) -> float:
        return min(0.35 + 0.65 * self.lit_s / self.pretence.grows_for_s, 1.02)

    def note(self, event: str, **more: Any) -> None:
        line = json.dumps({"time_s": round(self.now_s, 3), "event": event, "wall_s": time.time(), **more})
        with (self.run / "log.jsonl").open("a") as file:
            file.write(line + "\n")

    def _obey(self, order: Any) -> dict[str, Any]:
        self.orders.append(dict(order))
        self.note("order", **order)
        match order:
            case {"do": "stop"}:
                if self.stopped_s is None:
                    self.stopped_s = self.now_s
                    self._panel.tell_ended()
                    self.note("light off", why="order")
                    threading.Thread(target=self._end, daemon=True).start()
                return {"state": "after"}
            case {"do": "extend", "turns": turns}:
                self.turns_more += turns
                return {"turns": turns}
            case {"do": "mode", "mode": mode}:
                self.mode = mode
                return {"mode": mode}
        raise InputError("order", "is not known")

    def _end(self) -> None:
        time.sleep(self.pretence.after_s)
        self._write_results()
        LiveLink.withdraw(self.run)
        self.over.set()

    def _repeat(self, name: str, interval_s: float, act: Any) -> None:
        due = time.monotonic()
        while not self.over.is_set():
            if name not in self.paused:
                act()
            due = max(due + interval_s, time.monotonic())
            time.sleep(max(due - time.monotonic(), 0))

    def _tell_status(self) -> None:
        now = self.now_s
        turn = now * RIG.stage.speed_deg_s / 360
        state = "printing" if self.is_lit else "background" if self.stopped_s is None else "after"
        remaining = self.pretence.grows_for_s - self.lit_s + self.turns_more * 18
        status = PrintStatus(
            state, "light on" if self.is_lit else "light off", now, self.lit_s, turn, max(remaining, 0.0), self.mode,
            int(now * 10), 2, 12_300_000_000, 4321.0, int(now * 20) % 60 if self.is_lit else None,
            {"stage": "ok", "camera": "ok", "projector": "ok", "led": "not answering since 2 s"},
            ("[calibration.axis] is 120 days old",),
        )  # fmt: skip
        self._boxes["status"].put(status)
        shown = -1 if status.pattern is None else status.pattern
        with (self.run / "projector.csv").open("a") as file:
            file.write(f"{now:.4f},{now:.4f},{shown},{shown}\n")

    def _tell_snapshot(self) -> None:
        self._boxes["snapshot"].put(self._snapshot())
        frame, now, picture = self._frames.count, self.now_s, self._picture()
        self._frames.append(picture, np.deg2rad(now * 20), now)
        self._boxes["camera"].put(CameraImage(frame, picture, now, now * 20 % 360))

    def _snapshot(self) -> Snapshot:
        share = self.share
        cured = [np.where(image > 2 * TUBE_MM * (1 - share), image * share, 0) for image in self._sums]
        density = [180 * image + 12 * self._noise[: image.shape[0], : image.shape[1]] for image in cured]
        voxel, now = 17.2 / self.pretence.size, self.now_s
        return Snapshot(
            self._frames.count, now, now * 20 % 360, 0.06, 10.0, voxel, 0.0, _sums(density), _sums(cured),
            share * self.reference.volume_mm3, 0.02,
        )  # fmt: skip

    def _tell_surface(self) -> None:
        surface = self._surface()
        self._boxes["surface"].put(surface)
        write_history(self.run, self._snapshot(), surface)
        if self.pretence.with_surfaces:
            mesh = _mesh(surface.vertices_mm, self.reference)
            colours = deviation_colours(surface.deviation_mm, 0.1)
            path = self.run / "surfaces" / f"{surface.frames - 1:06d}.ply"
            write_ply(path, mesh, {"deviation_mm": surface.deviation_mm}, colours)

    def _surface(self) -> SurfaceSnapshot:
        vertices, deviation = grown(self.reference, self.share)
        slices = [180.0 * (image > 0.5) + 8 * self._noise[: image.shape[0], : image.shape[1]] for image in self._sums]
        gel = [np.where(image > 0.2, self.lit_s * (1 - image / 20), np.nan) for image in self._sums]
        rmse = float(np.sqrt(np.mean(deviation**2)))
        return SurfaceSnapshot(
            self._frames.count, self.now_s, self.lit_s, vertices, self.reference.faces.astype(np.int32),
            deviation, rmse, rmse * 1.1, self.share**2, self.share * self.reference.volume_mm3, _sums(slices),
            _sums(gel), StopForecast(self.pretence.grows_for_s, 20 / (1 + self.lit_s), "volume"),
        )  # fmt: skip

    def _picture(self) -> NDArray[np.uint16]:
        rows, columns = 300, 480
        beside = np.abs(np.arange(columns) - RIG.need_camera().axis_column) < 200
        glow = np.clip(1 - np.abs(np.arange(rows) - 150) / 70, 0, 1)[:, None] * beside
        counts = 200 + 3000 * glow * self.share + 40 * self._noise[:1].mean()
        return np.asarray(counts, dtype=np.uint16)

    def _reference_sums(self) -> list[NDArray[np.float64]]:
        size = self.pretence.size
        self._noise = np.random.default_rng(0).normal(size=(size, size)).astype(np.float32)
        return list(reference_sums(ring(5000), ViewGrid((size * 5 // 8, size, size), 17.2 / size, 0.0)))

    def _write_inputs(self) -> None:
        write_stl(self.run / "reference.stl", self.reference)
        (self.run / "rig.toml").write_text(rig_to_toml(RIG))
        facts = {"state": "printing", "inputs": {"part": {"file": self.pretence.part, "sha256": "0" * 64}}}
        write_json(self.run / "run.json", facts)
        row, column = np.mgrid[:120, :160]
        waves = [127 + 120 * np.sin(column / 9 + k / 3) * (np.abs(row - 60) < 40) for k in range(60)]
        angles = np.arange(60) * np.pi / 30
        patterns = Patterns(np.asarray(waves).astype(np.uint8), angles, 60, 80, 0.01)
        write_plan(
            self.run / "plan.h5", Plan(patterns, ring(500), np.zeros((2, 4, 4), np.float32), Grid((2, 4, 4), 0.1), RIG)
        )

    def _write_results(self) -> None:
        vertices, deviation = grown(self.reference, self.share)
        mesh = _mesh(vertices, self.reference)
        rmse = float(np.sqrt(np.mean(deviation**2)))
        write_stl(self.run / "surface.stl", mesh)
        write_volume(self.run / "volume.zarr", volume())
        write_ply(self.run / "deviation.ply", mesh, {"deviation_mm": deviation})
        write_json(self.run / "metrics.json", {"as_placed": {"rmse_mm": rmse, "iou": 0.97}})
        (self.run / "report.html").write_text("<!doctype html><title>Report</title><h1>Report of the ring</h1>")
        printed = {"frames": 100, "frames_missed": 2, "lit_s": self.lit_s, "lit_turns": 1.0, "ended_by": "order"}
        facts = {
            "state": "done",
            "printed": printed,
            "inputs": {"part": {"file": self.pretence.part, "sha256": "0" * 64}},
        }
        write_json(self.run / "run.json", facts)


def _mesh(vertices: Float32Array, like: Mesh) -> Mesh:
    return Mesh(vertices.astype(np.float64), like.faces)


def _sums(images: list[NDArray[Any]]) -> Sums:
    return Sums(*(np.ascontiguousarray(image, dtype=np.float32) for image in images))


class PretendProcess:
    """The same in a process of its own, as a real print is."""

    def __init__(self, run: Path, pretence: Pretence | None = None) -> None:
        settings = json.dumps(vars(pretence or Pretence()))
        self.process = subprocess.Popen([sys.executable, __file__, str(run), settings], stdin=subprocess.PIPE)
        deadline = time.monotonic() + 60
        while not (run / "live.json").exists():
            if self.process.poll() is not None or time.monotonic() > deadline:
                raise RuntimeError("the pretended print has not begun")
            time.sleep(0.02)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        assert self.process.stdin is not None
        self.process.stdin.close()  # it ends with its input, and so with the test, whatever becomes of it
        self.process.wait(20)

    def kill(self) -> None:
        assert self.process.stdin is not None
        self.process.kill()
        self.process.stdin.close()
        self.process.wait()


if __name__ == "__main__":
    with PretendPrint(Path(sys.argv[1]), replace(Pretence(), **json.loads(sys.argv[2]))) as made:
        sys.stdin.read()
