"""Print a little boat on the digital twin, and watch it form: hull first, then roof, posts last.

Makes ``process.png`` (dose, oxygen, conversion and the camera's frames over time) and ``sequence.png`` (what has gelled
after each turn, as in Fig. 5 of Orth et al. 2022, and how much of each feature)::

    python examples/simulated_print.py OUT
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from vialight.core.arrays import BoolArray, Float32Array, Grid, Volume
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns
from vialight.metrology.surface import isosurface
from vialight.planning.projections import Goal, light_for, make_patterns, method_named, optimise
from vialight.planning.target import target_grid, voxelise
from vialight.twin import Twin, TwinSettings, dose_a_turn_mj_per_cm2, find_rig, grid_round, load_resin, play

VOXEL_MM = 0.15
PATTERNS = 120
PASSES = 12

# Feature: lowest and highest x, y, z of its boxes, mm.
BOAT = {
    "hull": [((-3.0, 3.0), (-1.5, 1.5), (-2.0, 0.0))],
    "roof": [((-1.5, 1.5), (-1.2, 1.2), (1.5, 2.1))],
    "posts": [((x - 0.2, x + 0.2), (y - 0.2, y + 0.2), (0.0, 1.5)) for x in (-1.2, 1.2) for y in (-0.9, 0.9)],
}


@dataclass(frozen=True)
class Snapshot:
    """The middle of the print at a moment, (x, z) or (row, column) as pictures are drawn."""

    turn: float
    dose: Float32Array
    oxygen: Float32Array
    conversion: Float32Array
    frame: NDArray[np.uint16]
    gelled: BoolArray


def boxes(features: list[str], grid: Grid) -> BoolArray:
    """Return (z, y, x): which voxel centres lie in the boxes of some features."""
    inside = np.zeros(grid.shape, np.bool_)
    for feature in features:
        for (x0, x1), (y0, y1), (z0, z1) in BOAT[feature]:
            x, y, z = (grid.x_mm >= x0) & (grid.x_mm < x1), (grid.y_mm >= y0) & (grid.y_mm < y1), grid.z_mm
            inside |= ((z >= z0) & (z < z1))[:, None, None] & y[:, None] & x
    return inside


def boat() -> Mesh:
    """Return the boat as a mesh."""
    grid = Grid((100, 80, 140), 0.05)
    return isosurface(Volume(boxes(list(BOAT), grid).astype(np.float32), grid), 0.5)


def plan_patterns(part: Mesh, printer: Twin) -> Patterns:
    """Compute patterns for a part, simply: light stays in its slice."""
    rig = printer.rig
    grid = target_grid(part, VOXEL_MM)
    target = voxelise(part, grid, coverage=True)
    light = light_for(grid, PATTERNS, absorption_per_mm=printer.resin.absorption_per_mm)
    goal = Goal(np.ascontiguousarray(target.transpose(1, 2, 0)), light.reach)
    best, _ = optimise(goal, light, method_named("object-space"), PASSES)
    return make_patterns(best.projections, light, grid, rig)


def print_boat(brightness: float) -> tuple[list[Snapshot], Twin]:
    """Print until a quarter more light has come than gels the hull, and keep four snapshots a turn."""
    part, rig = boat(), find_rig("orth2022-190")
    projector = rig.need_projector()
    irradiance = brightness * (projector.irradiance_mw_per_cm2 or 0.0)
    rig = rig.model_copy(update={"projector": projector.model_copy(update={"irradiance_mw_per_cm2": irradiance})})
    twin = Twin(rig, load_resin("DUDMA"), grid_round(part, VOXEL_MM, margin_mm=1.0), TwinSettings(binning=2))
    patterns = plan_patterns(part, twin)
    critical = twin.resin.chemistry.critical_dose_mj_per_cm2(twin.resin.absorption_per_mm)
    turns = 1.25 * critical / dose_a_turn_mj_per_cm2(patterns, twin)
    turn_s = 360 / rig.stage.speed_deg_s
    snapshots: list[Snapshot] = []
    for moment in play(twin, patterns, turns=turns, dark_turns=1.0, frame_rate_hz=4 / turn_s):
        if moment.frame:
            middle = twin.state.conversion.shape[0] // 2
            dose, oxygen, conversion = (
                field[middle].T[::-1].copy()
                for field in (twin.dose_mj_per_cm2, twin.state.oxygen, twin.state.conversion)
            )
            gelled = np.isfinite(twin.gel_time_s.transpose(2, 0, 1))
            snapshots.append(Snapshot(twin.time_s / turn_s, dose, oxygen, conversion, moment.frame.counts, gelled))
    return snapshots, twin


def draw_process(snapshots: list[Snapshot], twin: Twin) -> Figure:
    """Draw dose, oxygen, conversion and frame, one column a moment."""
    first = next(i for i, snapshot in enumerate(snapshots) if snapshot.gelled.any())
    chosen = [snapshots[i] for i in np.linspace(max(1, first // 2), len(snapshots) - 1, 5).round().astype(int)]
    rows = (
        ("dose, mJ/cm$^2$", "dose", float(twin.dose_mj_per_cm2.max()), "inferno"),
        ("oxygen, mol/m$^3$", "oxygen", twin.resin.chemistry.oxygen_mol_per_m3, "viridis"),
        ("conversion", "conversion", float(twin.state.conversion.max()), "magma"),
        ("frame, counts", "frame", float(snapshots[-1].frame.max()), "gray"),
    )
    figure, axes = plt.subplots(len(rows), len(chosen), figsize=(12, 8), layout="constrained")
    for (title, name, highest, colours), line in zip(rows, axes, strict=True):
        for axis, snapshot in zip(line, chosen, strict=True):
            picture = axis.imshow(getattr(snapshot, name), vmin=0, vmax=highest, cmap=colours)
            axis.set_xticks([])
            axis.set_yticks([])
        line[0].set_ylabel(title)
        figure.colorbar(picture, ax=line)
    for axis, snapshot in zip(axes[0], chosen, strict=True):
        axis.set_title(f"{snapshot.turn:.1f} turns")
    return figure


def share_gelled(snapshots: list[Snapshot], grid: Grid) -> dict[str, NDArray[np.float64]]:
    """Return, for every feature, the share of its volume that has gelled at each snapshot."""
    return {
        feature: np.array([snapshot.gelled[boxes([feature], grid)].mean() for snapshot in snapshots])
        for feature in BOAT
    }


def draw_sequence(snapshots: list[Snapshot], grid: Grid) -> Figure:
    """Draw what has gelled, summed along y, x and z, and the course of each feature."""
    first = next(i for i, snapshot in enumerate(snapshots) if snapshot.gelled.any())
    chosen = [snapshots[i] for i in np.linspace(first, len(snapshots) - 1, 6).round().astype(int)]
    figure, axes = plt.subplots(4, len(chosen), figsize=(12, 9), layout="constrained")
    for column, snapshot in enumerate(chosen):
        for axis, summed in zip(axes[:3, column], (1, 2, 0), strict=True):
            picture = snapshot.gelled.sum(axis=summed)
            axis.imshow(picture[::-1], cmap="gray", vmin=0, vmax=grid.shape[summed] / 2)
            axis.set_axis_off()
        axes[0, column].set_title(f"{snapshot.turn:.1f} turns")
        axes[3, column].remove()
    course = figure.add_subplot(4, 1, 4)
    turns = [snapshot.turn for snapshot in snapshots]
    for feature, share in share_gelled(snapshots, grid).items():
        course.plot(turns, 100 * share, label=feature)
    course.set_xlabel("turns")
    course.set_ylabel("gelled, %")
    course.legend()
    return figure


def main(out: Path, brightness: float = 1.0) -> dict[str, float]:
    """Print, draw, and return the turn at which half of each feature had gelled.

    A projector that is brighter than the preset's by a factor prints in fewer turns.
    """
    out.mkdir(parents=True, exist_ok=True)
    snapshots, twin = print_boat(brightness)
    for name, figure in (
        ("process", draw_process(snapshots, twin)), ("sequence", draw_sequence(snapshots, twin.grid))
    ):  # fmt: skip
        figure.savefig(out / f"{name}.png", dpi=90)
        plt.close(figure)
    return half_gelled(twin)


def half_gelled(twin: Twin) -> dict[str, float]:
    """Return the turn at which half of each feature had gelled, infinite where it never had."""
    turns = np.nan_to_num(twin.gel_time_s.transpose(2, 0, 1), nan=np.inf) * twin.rig.stage.speed_deg_s / 360
    return {feature: float(np.median(turns[boxes([feature], twin.grid)])) for feature in BOAT}


if __name__ == "__main__":
    for feature, turn in main(Path(sys.argv[1] if len(sys.argv) > 1 else "simulated-print")).items():
        sys.stdout.write(f"half of the {feature} had gelled after {turn:.2f} turns\n")
