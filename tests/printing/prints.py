"""A quick printer and a plan for it, that the tests of live printing share."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from twin.rigs import patterns_of
from twin.test_print import upright_cylinder
from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.messages import StopForecast
from vialight.core.plan import Plan
from vialight.devices.simulated import Mishaps, SimulatedPrinter, WorldSettings
from vialight.printing.session import print_plan
from vialight.printing.settings import PrintSettings
from vialight.store import rig_to_toml, write_plan
from vialight.twin import TwinSettings, find_rig, load_resin

SPEED_DEG_S = 120.0
TURN_S = 360 / SPEED_DEG_S
BINNING = 4
REFRESH_HZ = 32.0


def quick_rig(speed_deg_s: float = SPEED_DEG_S) -> Rig:
    """The paper's printer, six times as fast unless told otherwise, and bright enough to gel within a turn."""
    rig = load_resin("DUDMA").in_vial_of(find_rig("orth2022-190"))
    return rig.model_copy(
        update={
            "stage": rig.stage.model_copy(update={"speed_deg_s": speed_deg_s}),
            "projector": rig.need_projector().model_copy(update={"irradiance_mw_per_cm2": 500.0}),
            "resin": rig.resin.model_copy(update={"threshold": 55.0}),
        }
    )


def recorded_rig() -> Rig:
    """The rig of the frames, which are binned."""
    rig = quick_rig()
    resin = rig.resin.model_copy(update={"threshold": 55.0 * BINNING**2})
    return rig.model_copy(update={"camera": rig.need_camera().binned(BINNING), "resin": resin})


def write_quick_plan(folder: Path) -> tuple[Path, Path]:
    """Write the plan of an upright cylinder, and the rig; return both paths."""
    images = np.zeros((90, 60, 300), np.uint8)
    images[:, :, np.abs(np.arange(300) - 149.5) * 0.065 < 1.49 * 2.5] = 200
    part = upright_cylinder(2.5, 3.6)
    grid = Grid((12, 20, 20), 0.4)
    write_plan(folder / "plan.h5", Plan(patterns_of(images), part, np.ones(grid.shape, np.float32), grid, quick_rig()))
    (folder / "rig.toml").write_text(rig_to_toml(quick_rig()), encoding="utf-8")
    return folder / "plan.h5", folder / "rig.toml"


@dataclass
class Bystander:
    """A watcher that sees nothing and says what it is told to say."""

    forecasts: list[StopForecast] = field(default_factory=list)
    told: str | None = None
    starts: int = 0
    room: int = 0

    def room_for(self, image_shape: tuple[int, int], turns: float) -> int:
        return self.room

    def start(self) -> None:
        self.starts += 1

    def is_ready(self) -> bool:
        return True

    def has_ended(self) -> bool:
        return False

    def fault(self) -> str | None:
        return self.told

    def forecast(self) -> StopForecast | None:
        return self.forecasts[-1] if self.forecasts else None

    def close(self) -> None:
        pass


@contextlib.contextmanager
def quick_printer(folder: Path, *, rate: float = 4.0, mishaps: Mishaps | None = None) -> Iterator[SimulatedPrinter]:
    """Start the simulated printer for the quick plan."""
    plan, rig = write_quick_plan(folder)
    run = folder / "run"
    run.mkdir()
    world = WorldSettings(plan, str(rig), "DUDMA", 0.4, TwinSettings(binning=BINNING), mishaps or Mishaps(), rate)
    with SimulatedPrinter(world, np.arange(90) * 2 * np.pi / 90, REFRESH_HZ, run / "projector.csv") as printer:
        yield printer


def quick_print(
    folder: Path, printer: SimulatedPrinter, *, turns: float = 2.0, watcher: Any = None, **others: Any
) -> dict[str, Any]:
    """Print the quick plan for some turns."""
    settings = others.pop("settings", None) or PrintSettings("turns", turns, give_up_s=others.pop("give_up_s", 12.0))
    return print_plan(
        recorded_rig(), printer.devices, folder / "run", printer.folder, settings, watcher or Bystander(), **others
    )
