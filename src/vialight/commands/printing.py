"""Print a plan, measured while it forms."""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from vialight.commands.kept_rehearsals import kept_stop_model
from vialight.commands.kinetics import REHEARSAL
from vialight.commands.measuring import measure_surface, reconstruct_recording
from vialight.commands.provenance import inputs_json, versions
from vialight.commands.shown_light import patterns_shown
from vialight.config import Rig, ThresholdConditions
from vialight.devices.opening import RealPrinter, names_devices
from vialight.devices.simulated import Mishaps, SimulatedPrinter, WorldSettings
from vialight.errors import InputError, VialightError
from vialight.feedback import FEWEST_TURNS, StopModel
from vialight.links import PrintStatus
from vialight.live import LiveSettings, LiveWatcher
from vialight.mesh import Mesh, load_mesh
from vialight.plan import Plan
from vialight.printing import PrintSettings, doubts_of_rig, print_plan
from vialight.report import growth_figure
from vialight.store import read_plan, rig_to_toml, write_json, write_stl
from vialight.twin import ResinModel, TwinSettings, find_rig, load_resin, resin_names
from vialight.web import PageProcess

RUN = "run.json"
_DEFAULT_RESIN = "DUDMA"


@dataclass(frozen=True)
class Simulation:
    """The printer that stands in where no devices are named.

    Parameters
    ----------
    resin
        What is truly in its vial, a preset or TOML; by default the rig's resin, where that is a preset.  What the print
        believes is the rig's resin, or this one where the rig names no preset.
    rate
        Seconds of the print in a second of the wall clock, where the machine keeps up.
    voxel_mm
        Of the resin.
    binning
        Of the camera's pixels.
    twin
        How closely to look; its binning is replaced.
    mishaps
        What is to go wrong.
    """

    resin: str | None = None
    rate: float = 1.0
    voxel_mm: float = 0.15
    binning: int = 1
    twin: TwinSettings = field(default_factory=TwinSettings)
    mishaps: Mishaps = field(default_factory=Mishaps)

    def __post_init__(self) -> None:
        if not (np.isfinite(self.rate) and 0.01 <= self.rate <= 100):
            raise InputError("--rate", f"is {self.rate}", accepted="0.01 to 100")


@dataclass(frozen=True)
class LiveOptions:
    """How a print is measured while it forms.

    Parameters
    ----------
    reference
        Mesh to compare with; by default the part as the plan has placed it.
    threshold
        I_p, counts per mm of the recorded pixels; by default the rig's.
    voxel_mm
        Of the live volume; by default that of a reconstruction.
    every_deg
        Turn of the object between volumes and surfaces that are kept.
    tolerance_mm
        For the verdict on the finished print.
    rehearsal_voxel_mm
        Of the resin in which the print is rehearsed.
    """

    reference: Path | None = None
    threshold: float | None = None
    voxel_mm: float | None = None
    every_deg: float = 360.0
    tolerance_mm: float | None = None
    rehearsal_voxel_mm: float = 0.2

    def __post_init__(self) -> None:
        if not (np.isfinite(self.every_deg) and self.every_deg >= 1):
            raise InputError("--every-deg", f"is {self.every_deg}", accepted="1 or more")


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
    job, model = _Job.read(Path(plan_path), rig_path, live, simulation), None
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
            write_json(run / RUN, result | {"state": "failed", "error": str(error) or type(error).__name__})
            raise
        truth = printer.write_truth(run / "truth.stl")
    printed |= patterns_shown(run)
    result |= {"state": "done", "printed": printed, "truth": truth, "elapsed_s": round(time.monotonic() - started, 3)}
    write_json(run / RUN, result)
    on_step("measuring the finished print")
    result |= _measured(run, live.tolerance_mm, 360 / job.rig.stage.speed_deg_s)
    write_json(run / RUN, result)
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


@dataclass(frozen=True)
class _Job:
    """A print that can begin: all inputs read and found to fit."""

    plan_path: Path
    plan: Plan
    rig: Rig
    recorded: Rig
    resin: ResinModel
    reference: Mesh
    live: LiveOptions
    simulation: Simulation
    rig_name: str
    is_real: bool

    @classmethod
    def read(cls, plan_path: Path, rig_path: str | Path, live: LiveOptions, simulation: Simulation) -> _Job:
        plan, rig = read_plan(plan_path), find_rig(rig_path)
        is_real = names_devices(rig)
        if is_real:
            _refuse_for_real_devices(simulation)
        named = rig.resin.name if rig.resin.name in resin_names() else None
        name = simulation.resin or named or _DEFAULT_RESIN
        resin = load_resin(named or name)
        reference = plan.reference if live.reference is None else load_mesh(live.reference)
        believed = rig if rig.resin.index_imaging is not None else resin.in_vial_of(rig)
        simulation = Simulation(
            name, simulation.rate, simulation.voxel_mm, simulation.binning, simulation.twin, simulation.mishaps
        )
        recorded = _as_recorded(believed, None if is_real else resin, live.threshold, simulation.binning)
        return cls(plan_path, plan, believed, recorded, resin, reference, live, simulation, str(rig_path), is_real)

    def with_threshold_of(self, model: StopModel) -> _Job:
        """Return the job with the rehearsal's I_p, where neither rig nor user gives one."""
        if self.rig.resin.threshold is not None or self.live.threshold is not None:
            return self
        gelled = self.resin.scattering.density(np.array([self.resin.chemistry.gel_conversion], np.float32))
        threshold = float(gelled[0]) / model.gel_share * self.simulation.binning**2
        resin = self.recorded.resin.model_copy(update={"threshold": threshold})
        return replace(self, recorded=self.recorded.model_copy(update={"resin": resin}))

    def write_to(self, run: Path, settings: PrintSettings) -> dict[str, Any]:
        """Write what is known before the print; return what ``run.json`` then holds."""
        shutil.copyfile(self.plan_path, run / "plan.h5")
        (run / "rig.toml").write_text(rig_to_toml(self.recorded), encoding="utf-8")
        write_stl(run / "reference.stl", self.reference)
        begun = {
            "kind": "print",
            "state": "printing",
            "name": self.plan.inputs.get("part", {}).get("file", self.plan_path.name),
            "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
            "inputs": inputs_json(plan=self.plan_path),
            "settings": asdict(settings) | {"every_deg": self.live.every_deg},
            "simulation": None if self.is_real else {
                "resin": self.simulation.resin, "rate": self.simulation.rate,
                "voxel_mm": self.simulation.voxel_mm, "binning": self.simulation.binning,
            },
            "versions": versions(),
        }  # fmt: skip
        write_json(run / RUN, begun)
        return begun

    def doubts(self) -> list[str]:
        """Say what is doubtful of the rig; the twin is always as it was calibrated."""
        return doubts_of_rig(self.rig, datetime.now().astimezone()) if self.is_real else []

    def printer(self, run: Path) -> SimulatedPrinter | RealPrinter:
        """Start the printer that the rig names, or the twin."""
        angles_rad, log = self.plan.patterns.angles_rad, run / "projector.csv"
        if self.is_real:
            return RealPrinter(self.rig, self.plan_path, angles_rad, log)
        simulation = self.simulation
        twin = TwinSettings(**(vars(simulation.twin) | {"binning": simulation.binning}))
        world = WorldSettings(
            self.plan_path, self.rig_name, simulation.resin or _DEFAULT_RESIN, simulation.voxel_mm, twin,
            simulation.mishaps, simulation.rate,
        )  # fmt: skip
        return SimulatedPrinter(world, angles_rad, self.rig.need_projector().frame_rate_hz, log)

    def live_settings(
        self, run: Path, mailboxes: Path, settings: PrintSettings, model: StopModel | None
    ) -> LiveSettings:
        """Return what the live measurement is to follow."""
        threshold = self.recorded.resin.threshold
        assert threshold is not None  # `_as_recorded` has seen to it
        turn_s = 360 / self.rig.stage.speed_deg_s
        frames = 2 * round(turn_s * settings.frame_rate_hz / 2)
        return LiveSettings(
            run, mailboxes, self.recorded, threshold, frames, self.reference, model, self.live.voxel_mm,
            self.live.every_deg,
        )  # fmt: skip


def _refuse_for_real_devices(simulation: Simulation) -> None:
    """Refuse what only the simulated printer can do."""
    for option, value, neutral in (("--rate", simulation.rate, 1.0), ("--bin", simulation.binning, 1)):
        if value != neutral:
            raise InputError(
                option, f"is {value}, but the rig names real devices", accepted=str(neutral), remedy="leave it out"
            )


def _as_recorded(rig: Rig, simulated: ResinModel | None, threshold: float | None, binning: int) -> Rig:
    """Return the rig of the recorded pixels, with a threshold that belongs to them.

    Counts of binned pixels are sums, and so is the threshold.  Where neither rig nor user gives one, and the twin
    prints, it is half of what its resin scatters at most: where a blurred edge is.
    """
    if threshold is None:
        threshold = _known_threshold(rig, simulated, binning)
    update = {"threshold": threshold, "threshold_conditions": None}
    return rig.model_copy(
        update={"camera": rig.need_camera().binned(binning), "resin": rig.resin.model_copy(update=update)}
    )


def _known_threshold(rig: Rig, simulated: ResinModel | None, binning: int) -> float:
    if rig.resin.threshold is None and simulated is not None:
        return float(simulated.scattering.density(np.ones(1, np.float32))[0]) / 2 * binning**2
    if simulated is None:
        return rig.need_threshold(rig.imaged_under())
    # The twin's counts are those that the rig was calibrated at, whatever its exposure and gain; its pixels add up.
    stated = rig.resin.threshold_conditions or ThresholdConditions()
    return rig.need_threshold() * (binning / (stated.binning or 1)) ** 2
