"""Which runs a page may show, and what is known of each: found here, so that no request ever names a path."""

from __future__ import annotations

import contextlib
import stat
from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.optics.viewing import vial_edge_columns
from vialight.store import list_history, list_surfaces
from vialight.store.rig_files import load_rig
from vialight.web.facts import Facts
from vialight.web.runs import Run, changed_at, is_run, own_file, runs_in

_MOST_RUNS = 500
_UNFINISHED = {"preflight", "background", "printing", "dark", "after", "finishing"}
"""States that a run is left in by a print that did not come to its end."""
_MOST_RIG_BYTES = 1_000_000

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
        self.is_single = is_run(self.root)
        self._by_key: dict[str, Run] = {}
        self.refresh()

    def refresh(self) -> list[Run]:
        """Look again; newest first."""
        folders = [self.root] if self.is_single else list(runs_in(self.root))
        runs = [Run.of(folder) for folder in sorted(folders, key=changed_at, reverse=True)[:_MOST_RUNS]]
        self._by_key = {run.key: run for run in runs}
        return runs

    def get(self, key: str) -> Run | None:
        """Return the run of a key that `refresh` gave; None for anything else."""
        return self._by_key.get(key)


def unreadable(run: Run, why: str) -> dict[str, Any]:
    """Return what the list shows of a run that cannot be read: that it is there, and why it is not shown."""
    return {
        "key": run.key, "name": run.name, "part": None, "started": _moment(changed_at(run.folder)),
        "state": "unreadable", "fault": why, "rmse_mm": None, "iou": None, "passed": None, "has_thumbnail": False,
    }  # fmt: skip


def overview(run: Run) -> dict[str, Any]:
    """Return what the list of runs shows of one, but for whether it is printing."""
    facts, metrics = Facts(run, "run.json"), Facts(run, "metrics.json")
    placed = metrics.table("as_placed")
    told = unreadable(run, "") | {
        "part": _part(facts),
        "started": facts.moment("started") or _moment(changed_at(run.folder)),
        "state": facts.text("state") or ("done" if facts else "unknown"),
        "rmse_mm": placed.number("rmse_mm"),
        "iou": placed.number("iou"),
        "passed": metrics.table("tolerance").truth("passed"),
        "has_thumbnail": bool(surfaces_of(run.folder) or history_of(run.folder)),
    }
    faults = facts.faults + metrics.faults
    return told | {"fault": "; ".join(faults[:3]) or None}


def summary(run: Run) -> dict[str, Any]:
    """Return what the page of one run needs beside its live state and its history."""
    facts, metrics = Facts(run, "run.json"), Facts(run, "metrics.json")
    rig = _rig(run)
    return overview(run) | {
        "files": [name for name, (file, _) in DOWNLOADS.items() if own_file(run.folder, file)],
        "surfaces": len(surfaces_of(run.folder)),
        "printed": facts.table("printed").plain(),
        "metrics": {name: metrics.table(name).plain() for name in ("as_placed", "aligned") if name in metrics},
        "camera": None if rig is None else camera_overlay(rig),
        "projector": None if rig is None else _canvas(rig),
        "speed_deg_s": None if rig is None else rig.stage.speed_deg_s,
    }


def with_state(told: dict[str, Any], *, is_live: bool | None) -> dict[str, Any]:
    """Add what a run's own files cannot be believed about: whether it is printing; None where that cannot be told.

    Examples
    --------
    >>> [with_state({"state": "printing"}, is_live=live)["state"] for live in (True, False, None)]
    ['printing', 'interrupted', 'uncertain']
    >>> with_state({"state": "done"}, is_live=False)["state"]
    'done'
    """
    if is_live:
        return told | {"state": "printing"}
    if told["state"] not in _UNFINISHED:
        return told
    return told | {"state": "interrupted" if is_live is False else "uncertain"}


def history_of(folder: Path) -> list[int]:
    """Return the numbers of the moments in a run's own history."""
    return list_history(folder) if _is_own(folder, "history") else []


def surfaces_of(folder: Path) -> list[int]:
    """Return the numbers of the surfaces that a run holds as its own."""
    return list_surfaces(folder) if _is_own(folder, "surfaces") else []


def _is_own(folder: Path, name: str) -> bool:
    with contextlib.suppress(OSError):
        return stat.S_ISDIR((folder / name).lstat().st_mode)
    return False


def _moment(time_s: float) -> str:
    return datetime.fromtimestamp(time_s, UTC).isoformat()


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
    path = own_file(run.folder, "rig.toml", most_bytes=_MOST_RIG_BYTES)
    with contextlib.suppress(InputError, RecursionError, ValueError):
        return None if path is None else load_rig(path)
    return None


def _part(facts: Facts) -> str | None:
    name = facts.text("name")
    if name is not None:
        return name
    inputs = facts.table("inputs")
    for role in ("part", "reference", "plan"):
        if role in inputs and (file := inputs.table(role).text("file")) is not None:
            return file
    return None


def run_changed(folder: Path) -> str:
    """Return a text that changes when a run's results do."""
    marks = []
    for name in ("run.json", "metrics.json", "report.html", "reference.stl", "rig.toml"):
        with contextlib.suppress(OSError):
            marks.append(f"{name}{(folder / name).lstat().st_mtime_ns}")
    return "-".join(marks)
