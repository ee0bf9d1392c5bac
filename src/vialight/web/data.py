"""What a run's folder holds, as messages for the page; read when asked for, and kept where that is dear.

All of it runs in processes apart from the server (see `vialight.web.reading`), since a folder may come from anywhere.
"""

from __future__ import annotations

import contextlib
import math
import time
from dataclasses import astuple
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns
from vialight.store import HistoryNumbers, read_history, read_history_numbers, read_plan, read_surface
from vialight.store.foreign.meshes import load_mesh
from vialight.web.catalogue import history_of, surfaces_of
from vialight.web.encoding import images_of, pack, pack_surface
from vialight.web.live_pictures import WIDEST, LivePictures
from vialight.web.recorded import pattern_shown, recorded_image
from vialight.web.reference import ReferenceSums, ViewGrid, reference_sums
from vialight.web.runs import Mark, Run, mark_of, own_file
from vialight.web.slices import FinalSlices

_GHOST_FACES = 60_000
"""Enough for what is only hinted at."""
_ROWS_AT_ONCE = 1000
_ROWS_WITHIN_S = 1.0
"""For reading rows that nobody has asked for before; the page asks for the rest."""
_MOST_ARCHIVE_BYTES = 256_000_000
_MOST_SURFACE_BYTES = 1_000_000_000
_MOST_TABLE_BYTES = 256_000_000


class RunData:
    """A run's content as the page wants it.

    Parameters
    ----------
    run
        The run.
    """

    def __init__(self, run: Run) -> None:
        self.run = run
        self.slices = FinalSlices(run.folder)
        self._pictures = LivePictures()
        # With what their files are known again by: a run may be removed, and printed anew under the same name.
        self._reference: tuple[Mark | None, Mesh] | None = None
        self._sums: tuple[Mark | None, ViewGrid, ReferenceSums] | None = None
        self._numbers: dict[int, tuple[Mark | None, HistoryNumbers]] = {}
        self._patterns: tuple[Mark | None, tuple[Patterns, int] | None] | None = None

    def reference(self) -> Mesh | None:
        """Return the mesh that is meant; None where the run does not hold it."""
        path = own_file(self.run.folder, "reference.stl", most_bytes=_MOST_SURFACE_BYTES)
        if path is None:
            return None
        changed = mark_of(path)
        if self._reference is None or self._reference[0] != changed:
            self._reference = None
            with contextlib.suppress(InputError):
                self._reference = changed, load_mesh(path)
        return self._reference[1] if self._reference else None

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
        if mesh is None or grid is None or self._reference is None:
            return None
        changed = self._reference[0]
        if self._sums is None or self._sums[:2] != (changed, grid):
            self._sums = changed, grid, reference_sums(mesh, grid)
        header = {"kind": "reference", "voxel_mm": grid.voxel_mm, "centre_z_mm": grid.centre_z_mm}
        return pack(header, images_of("reference", self._sums[2]))

    def _newest_grid(self) -> ViewGrid | None:
        numbers = history_of(self.run.folder)
        if not numbers:
            return None
        moment = read_history(self._holding(numbers[-1]), numbers[-1])
        shape = (moment.cured.xz.shape[0], *moment.cured.xy.shape)
        return ViewGrid((shape[0], shape[1], shape[2]), moment.voxel_mm, moment.centre_z_mm)

    def _holding(self, number: int) -> Path:
        """Return the run's folder, where the moment of a number in it is its own."""
        return self._with_own(_moment_file(number), _MOST_ARCHIVE_BYTES, "there is no such moment")

    def _with_own(self, name: str, most_bytes: int, fault: str) -> Path:
        if own_file(self.run.folder, name, most_bytes=most_bytes) is None:
            raise InputError(name, fault, accepted="a file of the run's own")
        return self.run.folder

    def curves(self, start: int) -> dict[str, Any]:
        """Return the numbers of some moments, from the `start`-th on, and which surfaces there are."""
        rows = []
        began = time.monotonic()
        for number in history_of(self.run.folder)[start : start + _ROWS_AT_ONCE]:
            mark = mark_of(self.run.folder / _moment_file(number))
            known = self._numbers.get(number)
            if known is None or known[0] != mark:
                if time.monotonic() - began > _ROWS_WITHIN_S:
                    break
                try:
                    known = mark, read_history_numbers(self._holding(number), number)
                except InputError:  # of one that is damaged nothing is shown, but its place is kept
                    known = mark, HistoryNumbers(number + 1, *(math.nan,) * 8)
                self._numbers[number] = known
            rows.append([number, *(_or_none(value) for value in astuple(known[1]))])
        columns = ["number", *HistoryNumbers.__dataclass_fields__]
        return {"start": start, "columns": columns, "rows": rows, "surfaces": surfaces_of(self.run.folder)}

    def moment(self, number: int) -> bytes:
        """Return a moment of the history; `InputError` where there is none."""
        moment = read_history(self._holding(number), number)
        images = images_of("density", moment.density) | images_of("cured", moment.cured)
        for kind, planes in (("slice", moment.slices), ("gel", moment.gel_time_s)):
            images |= {} if planes is None else images_of(kind, planes)
        known = {name: _or_none(value) for name, value in vars(moment.numbers).items()}
        place = {"voxel_mm": moment.voxel_mm, "centre_z_mm": moment.centre_z_mm}
        return pack({"kind": "moment", "number": number, **known, **place}, images)

    def surface(self, number: int) -> bytes:
        """Return a surface of the history; `InputError` where there is none."""
        name = f"surfaces/{number:06d}.ply"
        surface = read_surface(self._with_own(name, _MOST_SURFACE_BYTES, "there is no such surface"), number)
        return pack_surface(
            {"kind": "surface", "number": number}, surface.vertices_mm, surface.faces, surface.deviation_mm
        )

    def recorded_picture(self, number: int) -> bytes:
        """Return the camera's picture of a moment; `InputError` where it is not recorded."""
        folder = self.run.folder
        if own_file(folder, "frames.h5") is None:
            raise InputError("frames.h5", "is not there, or not the run's own")
        return self._pictures.camera(recorded_image(folder, number))

    def recorded_pattern(self, number: int) -> bytes | None:
        """Return what was projected at a moment; `InputError` where that is not recorded."""
        folder = self._with_own("projector.csv", _MOST_TABLE_BYTES, "is not there, or cannot be read")
        return self.pattern(pattern_shown(folder, read_history_numbers(self._holding(number), number).time_s))

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
        path = own_file(self.run.folder, "plan.h5")
        mark = mark_of(path)
        if self._patterns is None or self._patterns[0] != mark:
            self._patterns = None  # before others are in memory
            self._patterns = mark, None if path is None else _thinned_patterns(path)
        return self._patterns[1]


def _moment_file(number: int) -> str:
    return f"history/{number:06d}.npz"


def _thinned_patterns(path: Path) -> tuple[Patterns, int] | None:
    """Return a plan's patterns with every so many pixels, and how many; None where they cannot be read."""
    try:
        patterns = read_plan(path).patterns
    except InputError:
        return None
    step = -(-patterns.levels.shape[2] // WIDEST)
    levels = np.ascontiguousarray(patterns.levels[:, ::step, ::step])
    return Patterns(levels, patterns.angles_rad, patterns.first_row, patterns.first_column, 1.0), step


def _or_none(value: float) -> float | None:
    return None if isinstance(value, float) and not math.isfinite(value) else value
