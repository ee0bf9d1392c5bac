"""What a run's folder holds, as messages for the page; read when asked for, and kept where that is dear."""

from __future__ import annotations

import contextlib
import math
import threading
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.errors import InputError
from vialight.links import CameraImage, Snapshot, SurfaceSnapshot
from vialight.mesh import Mesh, load_mesh
from vialight.plan import Patterns
from vialight.store import (
    HistoryNumbers,
    list_history,
    list_surfaces,
    read_history,
    read_history_numbers,
    read_plan,
    read_surface,
)
from vialight.web.catalogue import Run
from vialight.web.encoding import images_of, pack, pack_surface, to_levels
from vialight.web.recorded import pattern_shown, recorded_image
from vialight.web.reference import ReferenceSums, ViewGrid, reference_sums
from vialight.web.slices import Slices

_WIDEST = 640
"""Columns of a picture of camera or projector as it is shown; more are averaged."""
_GHOST_FACES = 60_000
"""Enough for what is only hinted at."""


class RunData:
    """A run's content as the page wants it; every method may be called from any thread.

    Parameters
    ----------
    run
        The run.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.slices = Slices(run.folder)
        self._lock = threading.RLock()
        self._reference: Mesh | None = None
        self._sums: tuple[ViewGrid, ReferenceSums] | None = None
        self._numbers: dict[int, HistoryNumbers] = {}
        self._patterns: tuple[Patterns, int] | None = None
        self._has_no_plan = False
        self._white = 1.0

    def reference(self) -> Mesh | None:
        """Return the mesh that is meant; None where the run does not hold it."""
        with self._lock:
            if self._reference is None:
                with contextlib.suppress(InputError):
                    self._reference = load_mesh(self.run.folder / "reference.stl")
            return self._reference

    def reference_surface(self) -> bytes | None:
        """Return the reference as a message of the kind ``ghost``."""
        mesh = self.reference()
        if mesh is None:
            return None
        return pack_surface({"kind": "ghost"}, mesh.vertices_mm, mesh.faces, most_faces=_GHOST_FACES)

    def reference_sums(self, grid: ViewGrid | None = None) -> bytes | None:
        """Return the reference's sum projections on a grid, by default that of the newest moment."""
        mesh = self.reference()
        grid = grid or self._newest_grid()
        if mesh is None or grid is None:
            return None
        with self._lock:
            if self._sums is None or self._sums[0] != grid:
                self._sums = grid, reference_sums(mesh, grid)
            sums = self._sums[1]
        header = {"kind": "reference", "voxel_mm": grid.voxel_mm, "centre_z_mm": grid.centre_z_mm}
        return pack(header, images_of("reference", sums))

    def _newest_grid(self) -> ViewGrid | None:
        numbers = list_history(self.run.folder)
        if not numbers:
            return None
        moment = read_history(self.run.folder, numbers[-1])
        shape = (moment.cured.xz.shape[0], *moment.cured.xy.shape)
        return ViewGrid((shape[0], shape[1], shape[2]), moment.voxel_mm, moment.centre_z_mm)

    def curves(self, start: int) -> dict[str, Any]:
        """Return the numbers of the moments from the `start`-th on, and which surfaces there are."""
        rows = []
        for number in list_history(self.run.folder)[start:]:
            with self._lock:
                known = self._numbers.get(number)
            if known is None:
                try:
                    known = read_history_numbers(self.run.folder, number)
                except InputError:  # of one that is damaged nothing is shown, but its place is kept
                    known = HistoryNumbers(number + 1, *(math.nan,) * 8)
                with self._lock:
                    self._numbers[number] = known
            rows.append([number, *(_or_none(value) for value in astuple(known))])
        columns = ["number", *HistoryNumbers.__dataclass_fields__]
        return {"start": start, "columns": columns, "rows": rows, "surfaces": list_surfaces(self.run.folder)}

    def moment(self, number: int) -> bytes:
        """Return a moment of the history; `InputError` where there is none."""
        moment = read_history(self.run.folder, number)
        images = images_of("density", moment.density) | images_of("cured", moment.cured)
        for kind, planes in (("slice", moment.slices), ("gel", moment.gel_time_s)):
            images |= {} if planes is None else images_of(kind, planes)
        known = {name: _or_none(value) for name, value in vars(moment.numbers).items()}
        place = {"voxel_mm": moment.voxel_mm, "centre_z_mm": moment.centre_z_mm}
        return pack({"kind": "moment", "number": number, **known, **place}, images)

    def surface(self, number: int) -> bytes:
        """Return a surface of the history; `InputError` where there is none."""
        surface = read_surface(self.run.folder, number)
        return pack_surface(
            {"kind": "surface", "number": number}, surface.vertices_mm, surface.faces, surface.deviation_mm
        )

    def recorded_picture(self, number: int) -> bytes:
        """Return the camera's picture of a moment; `InputError` where it is not recorded."""
        return self.camera(recorded_image(self.run.folder, number))

    def recorded_pattern(self, number: int) -> bytes | None:
        """Return what was projected at a moment; `InputError` where that is not recorded."""
        return self.pattern(pattern_shown(self.run.folder, read_history_numbers(self.run.folder, number).time_s))

    def pattern(self, index: int | None) -> bytes | None:
        """Return a pattern of the plan, or black, as a message; None where the run holds no plan."""
        loaded = self._load_patterns()
        if loaded is None:
            return None
        patterns, step = loaded
        header = {
            "kind": "pattern",
            "index": index,
            "first_row": patterns.first_row,
            "first_column": patterns.first_column,
            "step": step,
        }
        if index is None or not 0 <= index < len(patterns.levels):
            return pack(header)
        angle = {"angle_deg": float(np.rad2deg(patterns.angles_rad[index]))}
        return pack(header | angle, {"levels": patterns.levels[index]})

    def _load_patterns(self) -> tuple[Patterns, int] | None:
        with self._lock:
            if self._patterns is None and not self._has_no_plan:
                try:
                    patterns = read_plan(self.run.folder / "plan.h5").patterns
                except InputError:
                    self._has_no_plan = True
                    return None
                step = -(-patterns.levels.shape[2] // _WIDEST)
                levels = np.ascontiguousarray(patterns.levels[:, ::step, ::step])
                self._patterns = (
                    Patterns(levels, patterns.angles_rad, patterns.first_row, patterns.first_column, 1.0),
                    step,
                )
            return self._patterns

    def snapshot(self, snapshot: Snapshot) -> bytes:
        """Return a live snapshot as a message."""
        names = (
            "frames", "time_s", "angle_deg", "latency_s", "frame_rate_hz", "voxel_mm", "centre_z_mm",
            "cured_volume_mm3", "provisional_share",
        )  # fmt: skip
        header = {name: getattr(snapshot, name) for name in names}
        images = images_of("density", snapshot.density) | images_of("cured", snapshot.cured)
        return pack({"kind": "snapshot", **header}, images)

    def planes(self, surface: SurfaceSnapshot) -> bytes:
        """Return the slices and gel times that came with a live surface."""
        images = images_of("slice", surface.slices) | images_of("gel", surface.gel_time_s)
        return pack({"kind": "planes", "frames": surface.frames, "time_s": surface.time_s}, images)

    def live_surface(self, surface: SurfaceSnapshot) -> bytes:
        """Return a live surface as a message."""
        names = ("frames", "time_s", "lit_s", "rmse_mm", "reverse_rmse_mm", "iou", "cured_volume_mm3")
        header: dict[str, Any] = {"kind": "surface", **{name: getattr(surface, name) for name in names}}
        if surface.forecast is not None:
            header["forecast"] = vars(surface.forecast)
        return pack_surface(header, surface.vertices_mm, surface.faces, surface.deviation_mm)

    def camera(self, image: CameraImage) -> bytes:
        """Return the camera's picture, averaged to what is shown, on a scale that only grows."""
        step = -(-image.counts.shape[1] // _WIDEST)
        small = _block_mean(image.counts, step)
        self._white = max(self._white, float(np.quantile(small[::2, ::2], 0.999)))
        header = {
            "kind": "camera", "frame": image.frame, "time_s": image.time_s, "angle_deg": image.angle_deg, "step": step,
            "rows": image.counts.shape[0], "columns": image.counts.shape[1],
        }  # fmt: skip
        return pack(header, {"counts": to_levels(small, 0.0, self._white)})


def grid_of(snapshot: Snapshot) -> ViewGrid:
    """Return where the pixels of a snapshot lie."""
    (z, x), y = snapshot.density.xz.shape, snapshot.density.xy.shape[0]
    return ViewGrid((z, y, x), snapshot.voxel_mm, snapshot.centre_z_mm)


def _block_mean(counts: NDArray[Any], step: int) -> NDArray[np.float32]:
    if step == 1:
        return counts.astype(np.float32)
    rows, columns = (size // step for size in counts.shape)
    blocks = counts[: rows * step, : columns * step].reshape(rows, step, columns, step)
    return np.asarray(blocks.mean(axis=(1, 3), dtype=np.float32))


def _or_none(value: float) -> float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def run_changed(folder: Path) -> str:
    """Return a text that changes when a run's results do."""
    marks = []
    for name in ("run.json", "metrics.json", "report.html", "reference.stl", "rig.toml"):
        with contextlib.suppress(OSError):
            marks.append(f"{name}{(folder / name).stat().st_mtime_ns}")
    return "-".join(marks)
