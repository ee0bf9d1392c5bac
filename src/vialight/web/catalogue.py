"""Which runs a page may show, and what is known of each: found here, so that no request ever names a path."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vialight.config import Rig, load_rig
from vialight.errors import InputError
from vialight.links import find_live_print
from vialight.store import list_history, list_surfaces, read_json
from vialight.viewing import vial_edge_columns

_MARKS = ("run.json", "live.json", "frames.h5", "history", "reconstruction.json")
_MOST_RUNS = 500

DOWNLOADS: Mapping[str, tuple[str, str]] = {
    "surface.stl": ("surface.stl", "model/stl"),
    "deviation.ply": ("deviation.ply", "application/octet-stream"),
    "reference.stl": ("reference.stl", "model/stl"),
    "metrics.json": ("metrics.json", "application/json"),
    "reconstruction.json": ("reconstruction.json", "application/json"),
    "run.json": ("run.json", "application/json"),
    "log.jsonl": ("log.jsonl", "application/json"),
    "report.html": ("report.html", "text/html"),
}
"""What can be fetched of a run: name in the address to file and media type."""


@dataclass(frozen=True)
class Run:
    """A run's folder under a name of ours."""

    key: str
    """What addresses call it: of letters and digits."""
    name: str
    folder: Path


class Catalogue:
    """The runs that a server shows.

    Parameters
    ----------
    root
        A run's folder, or a folder of runs.

    Raises
    ------
    InputError
        There is no such folder.
    """

    def __init__(self, root: str | Path) -> None:
        self.root = Path(root).resolve()
        if not self.root.is_dir():
            raise InputError(root, "there is no such folder", accepted="a run's folder, or a folder of runs")
        self.is_single = _is_run(self.root)
        self._by_key: dict[str, Run] = {}
        self.refresh()

    def refresh(self) -> list[Run]:
        """Look again; newest first."""
        folders = [self.root] if self.is_single else [item for item in self.root.iterdir() if _is_run(item)]
        newest = sorted(folders, key=_changed, reverse=True)[:_MOST_RUNS]
        runs = [Run(hashlib.sha256(folder.name.encode()).hexdigest()[:12], folder.name, folder) for folder in newest]
        self._by_key = {run.key: run for run in runs}
        return runs

    def get(self, key: str) -> Run | None:
        """Return the run of a key that `refresh` gave; None for anything else."""
        return self._by_key.get(key)


def _is_run(folder: Path) -> bool:
    return not folder.name.startswith(".") and folder.is_dir() and any((folder / mark).exists() for mark in _MARKS)


def _changed(folder: Path) -> float:
    times = [path.stat().st_mtime for mark in ("run.json", "live.json") if (path := folder / mark).exists()]
    return max(times, default=folder.stat().st_mtime)


def overview(run: Run) -> dict[str, Any]:
    """Return what the list of runs shows of one."""
    facts = _json(run.folder / "run.json")
    metrics = _json(run.folder / "metrics.json")
    placed = metrics.get("as_placed") or {}
    return {
        "key": run.key,
        "name": run.name,
        "part": _part(facts),
        "started": facts.get("started") or datetime.fromtimestamp(_changed(run.folder), UTC).isoformat(),
        "state": "printing" if find_live_print(run.folder) else str(facts.get("state", "done" if facts else "unknown")),
        "rmse_mm": placed.get("rmse_mm"),
        "iou": placed.get("iou"),
        "passed": (metrics.get("tolerance") or {}).get("passed"),
        "has_thumbnail": bool(list_surfaces(run.folder) or list_history(run.folder)),
    }


def summary(run: Run) -> dict[str, Any]:
    """Return what the page of one run needs beside its live state and its history."""
    facts = _json(run.folder / "run.json")
    metrics = _json(run.folder / "metrics.json")
    rig = _rig(run)
    return overview(run) | {
        "files": [name for name, (file, _) in DOWNLOADS.items() if (run.folder / file).is_file()],
        "surfaces": len(list_surfaces(run.folder)),
        "printed": facts["printed"] if isinstance(facts.get("printed"), dict) else {},
        "metrics": {name: metrics[name] for name in ("as_placed", "aligned") if isinstance(metrics.get(name), dict)},
        "camera": None if rig is None else camera_overlay(rig),
        "projector": None if rig is None else _canvas(rig),
        "speed_deg_s": None if rig is None else rig.stage.speed_deg_s,
    }


def camera_overlay(rig: Rig) -> dict[str, Any] | None:
    """Return where the rig has the vial's edges, the axis and the optical row in the camera's image, in pixels."""
    if rig.camera is None:
        return None
    edges: tuple[float, float] | None = None
    with contextlib.suppress(InputError):
        optics = rig.imaging_optics()
        edges = None if optics is None else vial_edge_columns(rig.camera, optics)
    return {
        "axis_column": rig.camera.axis_column,
        "optical_row": rig.camera.optical_row,
        "edge_columns": edges,
        "pixel_mm": rig.camera.pixel_mm,
    }


def _canvas(rig: Rig) -> dict[str, Any] | None:
    if rig.projector is None:
        return None
    return {
        "columns": rig.projector.columns,
        "rows": rig.projector.rows,
        "axis_column": rig.projector.axis_column,
        "pixel_mm": rig.projector.pixel_mm,
    }


def _rig(run: Run) -> Rig | None:
    with contextlib.suppress(InputError):
        return load_rig(run.folder / "rig.toml")
    return None


def _part(facts: Mapping[str, Any]) -> str | None:
    if isinstance(facts.get("name"), str):
        return str(facts["name"])
    inputs = facts.get("inputs")
    if not isinstance(inputs, dict):
        return None
    for role in ("part", "reference", "plan"):
        given = inputs.get(role)
        if isinstance(given, dict) and isinstance(given.get("file"), str):
            return str(given["file"])
    return None


def _json(path: Path) -> dict[str, Any]:
    with contextlib.suppress(InputError):
        return read_json(path)
    return {}


def log_lines(run: Run, start: int) -> list[dict[str, Any]]:
    """Return the run's log from an event on; a line that is not whole yet is left for later."""
    with contextlib.suppress(OSError):
        lines = (run.folder / "log.jsonl").read_bytes().split(b"\n")[:-1]
        return [_event(line) for line in lines[start:]]
    return []


def _event(line: bytes) -> dict[str, Any]:
    with contextlib.suppress(ValueError):
        event = json.loads(line)
        if isinstance(event, dict):
            return event
    return {"event": "a line that cannot be read"}
