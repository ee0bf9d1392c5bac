"""Print a plan, measured while it forms."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from vialight.commands.measure import measure_surface
from vialight.commands.print_job import RUN, LiveOptions, PrintJob, Simulation
from vialight.commands.reconstruct import reconstruct_recording
from vialight.control.kept_rehearsals import kept_stop_model
from vialight.control.stop_model import FEWEST_TURNS, REHEARSAL
from vialight.core.errors import InputError, VialightError
from vialight.core.messages import PrintStatus
from vialight.metrology.kinetics.shown_light import patterns_shown
from vialight.printing.live.watcher import LiveWatcher
from vialight.printing.session import print_plan
from vialight.printing.settings import PrintSettings
from vialight.report import growth_figure
from vialight.store import write_json
from vialight.store.foreign.meshes import load_mesh
from vialight.web import PageProcess


def print_part(
    plan_path: str | Path,
    rig_path: str | Path,
    out: str | Path,
    *,
    settings: PrintSettings | None = None,
    live: LiveOptions | None = None,
    simulation: Simulation | None = None,
    keep_going: Callable[[], bool] = lambda: True,
    on_status: Callable[[PrintStatus], None] = lambda status: None,
    on_step: Callable[[str], None] = lambda message: None,
    on_rehearsal: Callable[[int, int], None] | None = None,
    serve: bool = False,
) -> dict[str, Any]:
    """Print a plan, record and measure it while it forms, and measure what came of it.

    Parameters
    ----------
    plan_path, rig_path
        The plan, HDF5; the printer: TOML, or the name of a preset.
    out
        The run's folder, see ``docs/run-folder.md``; it must not hold anything yet.
    settings
        How to print, and when to stop.
    live
        How to measure.
    simulation
        The printer.
    keep_going
        Asked all the time; False ends the light at once and the print in its usual way.
    on_status, on_step
        Told how the print is doing, several times a second; and in words what is done besides.
    on_rehearsal
        Called with rehearsals done and to do.
    serve
        Show it in a browser, from a process of its own.

    Returns
    -------
    dict
        What ``run.json`` holds.

    Raises
    ------
    InputError
        Plan, rig or settings cannot be used, or a check before the print fails.
    DeviceError
        A device fails before there is light.
    """
    settings, live, simulation = settings or PrintSettings(), live or LiveOptions(), simulation or Simulation()
    job, model = PrintJob.read(Path(plan_path), rig_path, live, simulation), None
    if settings.stop == "auto":
        on_step("rehearsing the print, to know when to stop")
        model = kept_stop_model(
            job.plan, job.recorded, job.resin, voxel_mm=live.rehearsal_voxel_mm, progress=on_rehearsal
        )
        job = job.with_threshold_of(model)
        if model.nominal_turns < FEWEST_TURNS:
            on_step(
                f"warning: this print wants light for {model.nominal_turns:.1f} turns, and a forecast comes too late "
                f"below {FEWEST_TURNS:g}: lower the projector's irradiance, or turn faster"
            )
    run = _new_folder(Path(out))
    started = time.monotonic()
    result = job.write_to(run, settings)
    if model is not None:
        write_json(run / REHEARSAL, model.to_json())
    on_step("starting the printer")
    with _folder_only_if_it_starts(run):
        opened = job.printer(run)
    with opened as printer, contextlib.ExitStack() as stack:
        for told in printer.told:
            on_step(told)
        if serve:
            on_step(f"open {stack.enter_context(PageProcess(run)).link}")
        watcher = LiveWatcher(job.live_settings(run, printer.folder, settings, model))
        try:
            printed = print_plan(
                job.recorded, printer.devices, run, printer.folder, settings, watcher,
                keep_going=keep_going, on_status=_telling_doubts(on_status, on_step), doubts=job.doubts(),
            )  # fmt: skip
        except BaseException as error:
            write_json(
                run / RUN, result | {"state": "failed", "error": str(error) or type(error).__name__}, durable=True
            )
            raise
        truth = printer.write_truth(run / "truth.stl")
    printed |= patterns_shown(run)
    result |= {"state": "done", "printed": printed, "truth": truth, "elapsed_s": round(time.monotonic() - started, 3)}
    write_json(run / RUN, result, durable=True)
    on_step("measuring the finished print")
    result |= _measured(run, live.tolerance_mm, 360 / job.rig.stage.speed_deg_s)
    write_json(run / RUN, result, durable=True)
    return result


def _telling_doubts(
    on_status: Callable[[PrintStatus], None], on_step: Callable[[str], None]
) -> Callable[[PrintStatus], None]:
    """Return what passes a status on, and tells each doubt once."""
    told: set[str] = set()

    def tell(status: PrintStatus) -> None:
        for doubt in status.doubts:
            if doubt not in told:
                on_step(f"doubtful: {doubt}")
        told.update(status.doubts)
        on_status(status)

    return tell


@contextlib.contextmanager
def _folder_only_if_it_starts(run: Path) -> Iterator[None]:
    """Take the run's folder away where the printer does not start: nothing has happened, and it is tried again."""
    try:
        yield
    except BaseException:
        shutil.rmtree(run, ignore_errors=True)
        raise


def _measured(run: Path, tolerance_mm: float | None, turn_s: float) -> dict[str, Any]:
    """Reconstruct and measure a finished print; what cannot be measured is told, and loses nothing."""
    try:
        reconstruct_recording(run / "frames.h5", run / "rig.toml", run)
        grown = growth_figure(run, turn_s, load_mesh(run / "reference.stl").volume_mm3)
        figures = [] if grown is None else [grown]
        return {
            "measured": measure_surface(run, run / "reference.stl", run, tolerance_mm=tolerance_mm, figures=figures)
        }
    except VialightError as error:
        return {"measured": None, "why_not_measured": str(error)}


def _new_folder(out: Path) -> Path:
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise InputError(out, "holds something already", accepted="a new folder", remedy="choose another name")
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise InputError(out, f"cannot be made ({error.strerror})", remedy="check the path") from error
    return out
