"""What vialight shows of itself: a part planned, printed on the twin and measured while it forms."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from importlib.resources import as_file, files
from pathlib import Path
from typing import Any

from vialight.commands.measure import measure_surface
from vialight.commands.plan import plan_part
from vialight.commands.plan_settings import PlanSettings
from vialight.commands.print import print_part
from vialight.commands.print_job import RUN, LiveOptions, Simulation
from vialight.commands.reconstruct import reconstruct_recording
from vialight.core.messages import PrintStatus
from vialight.store import read_json
from vialight.tomography.reconstruct import Progress

_PLAN = PlanSettings(voxel_mm=0.3, angles=180, passes=8)
_LIVE = LiveOptions(voxel_mm=0.155, every_deg=90.0, rehearsal_voxel_mm=0.3)
_SIMULATION = Simulation(rate=8.0, voxel_mm=0.3)
"""Coarse, so that all of it takes a minute or two: voxels three to five times as large as a print deserves."""


def print_demo(
    out: str | Path,
    *,
    serve: bool = False,
    keep_going: Callable[[], bool] = lambda: True,
    on_status: Callable[[PrintStatus], None] = lambda status: None,
    on_step: Callable[[str], None] = lambda message: None,
) -> dict[str, Any]:
    """Plan the sample part, print it on the twin until the forecast stops it, and measure what came of it.

    Parameters
    ----------
    out
        Folder for ``plan.h5``, ``plan.html`` and the print's ``run``; an earlier demo's are replaced.
    serve, keep_going, on_status, on_step
        See `vialight.commands.print.print_part`.

    Returns
    -------
    dict
        What ``run/run.json`` holds.

    Raises
    ------
    InputError
        `out` cannot be written.
    """
    out = Path(out)
    out.mkdir(exist_ok=True)
    if (out / "run" / RUN).exists() and read_json(out / "run" / RUN).get("name") == "part.stl":
        shutil.rmtree(out / "run")
    with as_file(files("vialight") / "commands" / "sample") as sample:
        on_step("planning the light patterns of the sample part")
        plan_part(sample / "part.stl", sample / "printer.toml", out / "plan.h5", settings=_PLAN)
        return print_part(
            out / "plan.h5", sample / "printer.toml", out / "run", live=_LIVE, simulation=_SIMULATION, serve=serve,
            keep_going=keep_going, on_status=on_status, on_step=on_step,
        )  # fmt: skip


def measure_demo(out: str | Path, *, progress: Progress | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
    """Reconstruct and measure the sample recording; return what both steps found."""
    with as_file(files("vialight") / "commands" / "sample") as sample:
        first = reconstruct_recording(sample / "frames.h5", sample / "rig.toml", out, progress=progress)
        return first, measure_surface(out, sample / "part.stl", out, tolerance_mm=0.1)
