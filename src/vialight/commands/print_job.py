"""A print that can begin: what it needs, read and found to fit, before any device is opened."""

from __future__ import annotations

import shutil
import time
from dataclasses import asdict, dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from vialight.control.stop_model import StopModel
from vialight.core.config import Rig, ThresholdConditions
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.devices.opening import RealPrinter, names_devices
from vialight.devices.simulated import Mishaps, SimulatedPrinter, WorldSettings
from vialight.printing.doubts import doubts_of_rig
from vialight.printing.live.following import LiveSettings
from vialight.printing.settings import PrintSettings
from vialight.store import read_plan, rig_to_toml, write_json, write_stl
from vialight.store.foreign.meshes import load_mesh
from vialight.store.provenance import inputs_json, versions
from vialight.twin import ResinModel, TwinSettings, find_rig, load_resin, resin_names

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


@dataclass(frozen=True)
class PrintJob:
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
    def read(cls, plan_path: Path, rig_path: str | Path, live: LiveOptions, simulation: Simulation) -> PrintJob:
        """Read plan and rig, and settle what is believed of the resin.

        Raises
        ------
        InputError
            They cannot be used, or options of the simulated printer are given for a real one.
        """
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

    def with_threshold_of(self, model: StopModel) -> PrintJob:
        """Return the job with the rehearsal's I_p, where neither rig nor user gives one."""
        if self.rig.resin.threshold is not None or self.live.threshold is not None:
            return self
        threshold = self.resin.gel_density / model.gel_share * self.simulation.binning**2
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
        write_json(run / RUN, begun, durable=True)
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
