"""Iterate the paper's dose normalisation in its variants, and print what each pass brings as tables.

Usage: ``python benchmarks/normalisation.py [--markdown docs/normalisation.md]``.  A minute on two cores.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from itertools import islice
from pathlib import Path

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.mesh import Mesh
from vialight.planning.projections import Goal, Light, dose_of, light_for
from vialight.planning.projections.forward import filtered_projections
from vialight.planning.projections.methods import normalised
from vialight.planning.scoring import Score, score_dose
from vialight.planning.shapes import bracket, gyroid, thin_wall_box
from vialight.planning.target import target_grid, voxelise
from vialight.tomography.radon import backproject, ramp_filter

VOXEL_MM, ANGLES = 0.3, 120
PASSES = (1, 2, 4, 8, 16, 32)
POWER_STEPS = 60
VARIANTS = ((0.5, 0.0), (0.5, 0.5), (0.7, 0.0), (0.7, 0.35), (0.85, 0.0), (0.85, 0.85))
"""Background, clip level."""

Shrink = Callable[[Float32Array], Float32Array]
"""A volume to the dose of its unclipped filtered projections."""


def main() -> None:
    """Print the tables, or put them into a page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--markdown", type=Path, help="the page whose tables are to be replaced")
    page = parser.parse_args().markdown
    tables = "\n\n".join([*(iteration_table(name, part) for name, part in parts().items()), eigenvalue_table()])
    if page is None:
        print(tables)
        return
    before, after = page.read_text(encoding="utf-8").split("<!-- tables -->")[::2]
    page.write_text(f"{before}<!-- tables -->\n\n{tables}\n\n<!-- tables -->{after}", encoding="utf-8")


def parts() -> dict[str, Mesh]:
    """Return the parts that are tried."""
    return {
        "gyroid, 1 mm walls": gyroid(pitch_mm=0.2), "bracket": bracket(pitch_mm=0.2),
        "box of 0.6 mm walls": thin_wall_box(wall_mm=0.6),
    }  # fmt: skip


def iteration_table(name: str, part: Mesh) -> str:
    """Return Jaccard index and in-part dose range after so many passes of each variant."""
    grid = target_grid(part, VOXEL_MM)
    light = light_for(grid, ANGLES)
    goal = Goal(np.ascontiguousarray(voxelise(part, grid).transpose(1, 2, 0)), light.reach)
    lines = [
        f"**{name}** ({' x '.join(map(str, grid.shape))} voxels): Jaccard index, in-part dose range", "",
        "| background | clip level | void | " + " | ".join(f"{count}" for count in PASSES) + " | best |",
        "| --- | --- | --- |" + " --- |" * (len(PASSES) + 1),
    ]  # fmt: skip
    for background, level in VARIANTS:
        for bound in (False, True):
            scores = scores_of(goal, light, background, level, bound=bound)
            best = max(range(len(scores)), key=lambda k: (round(scores[k].jaccard, 4), -scores[k].in_part_dose_range))
            cells = [f"{scores[k - 1].jaccard:.4f}, {scores[k - 1].in_part_dose_range:.2f}" for k in PASSES]
            title = "upper bound" if bound else "as printed"
            lines.append(f"| {background:g} | {level:g} | {title} | {' | '.join(cells)} | {best + 1} |")
    return "\n".join(lines)


def scores_of(goal: Goal, light: Light, background: float, level: float, *, bound: bool) -> list[Score]:
    """Judge the dose of every pass."""
    states = normalised(goal, light, background=background, clip_level=level, bound_void=bound)
    judged = np.broadcast_to(light.reach > 0, goal.inside.shape)
    return [score_dose(state.dose, goal.inside, judged) for state in islice(states, PASSES[-1])]


def eigenvalue_table() -> str:
    """Return the largest eigenvalue of A' ramp A for each pair and some grids."""
    lines = [
        "| voxels | angles | pi x voxels / angles | strips and squares | points, linear | points, nearest |",
        "| --- | --- | --- | --- | --- | --- |",
    ]
    for count, angles in ((32, 60), (64, 120), (64, 360), (128, 180)):
        values = (f"{largest_eigenvalue(pair, count):.3f}" for pair in pairs(count, angles).values())
        lines.append(f"| {count} x {count} | {angles} | {np.pi * count / angles:.3f} | {' | '.join(values)} |")
    return "\n".join(["Largest eigenvalue of A' ramp A, within the circle that all projections see", "", *lines])


def pairs(count: int, angles: int) -> dict[str, Shrink]:
    """Return A' ramp A of several projectors, all in the scale where it is near 1 for smooth volumes."""
    light = light_for(Grid((1, count, count), 1.0), angles)
    geometry = light.geometry
    ramp = ramp_filter("ram-lak", geometry.samples, 1.0)
    step = np.float32(np.pi / len(geometry.psi_rad))

    def read_at_points(views: Float32Array) -> Float32Array:
        return backproject(views, geometry.psi_rad, geometry.first_s_mm, 1.0, geometry.x_mm, geometry.y_mm)

    def matched(volume: Float32Array) -> Float32Array:
        return dose_of(filtered_projections(volume, light), light)

    def point_sampled(volume: Float32Array) -> Float32Array:
        views = np.matmul(ramp, dealt_to_samples(volume, geometry.psi_rad, geometry.samples))
        return np.asarray(read_at_points(np.asarray(views, np.float32)) * step, np.float32)

    def nearest(volume: Float32Array) -> Float32Array:
        views = np.matmul(ramp, dealt_to_samples(volume, geometry.psi_rad, geometry.samples, whole=True))
        return read_nearest(np.asarray(views, np.float32), geometry.psi_rad, count) * step

    return {"strips": matched, "linear": point_sampled, "nearest": nearest}


def dealt_to_samples(volume: Float32Array, psi_rad: FloatArray, samples: int, *, whole: bool = False) -> Float32Array:
    """Return the transpose of reading at points: each pixel is dealt to the two samples next to its ray, or to one."""
    views = np.zeros((len(psi_rad), samples, 1), np.float32)
    for view, angle in zip(views[:, :, 0], psi_rad, strict=True):
        position = positions(len(volume), float(angle), samples)
        inside = (position >= 0) & (position < samples - 1)
        if whole:
            view += np.bincount(np.rint(position[inside]).astype(np.int64), volume[:, :, 0].ravel()[inside], samples)
            continue
        index, values = position[inside].astype(np.int64), volume[:, :, 0].ravel()[inside]
        share = position[inside] - index
        view += np.bincount(index, values * (1 - share), samples) + np.bincount(index + 1, values * share, samples)
    return views


def read_nearest(views: Float32Array, psi_rad: FloatArray, count: int) -> Float32Array:
    """Return the sum over angles of the sample nearest to each pixel's ray."""
    total = np.zeros(count * count, np.float32)
    for view, angle in zip(views[:, :, 0], psi_rad, strict=True):
        position = positions(count, float(angle), len(view))
        inside = (position >= 0) & (position < len(view) - 1)
        total[inside] += view[np.rint(position[inside]).astype(np.int64)]
    return total.reshape(count, count, 1)


def positions(count: int, angle: float, samples: int) -> FloatArray:
    """Return where pixels' rays lie among the samples, in samples."""
    axis = np.arange(count) - (count - 1) / 2
    return np.asarray((axis * np.cos(angle) - axis[:, None] * np.sin(angle) + (samples - 1) / 2).ravel())


def largest_eigenvalue(shrink: Shrink, count: int) -> float:
    """Return it by power iteration, from noise, among volumes within the circle in the grid."""
    axis = np.arange(count) - (count - 1) / 2
    within = (np.hypot(axis, axis[:, None]) < count / 2 - 1)[:, :, None]
    volume = np.random.default_rng(1).normal(size=(count, count, 1)).astype(np.float32) * within
    size = 0.0
    for _ in range(POWER_STEPS):
        volume = volume / np.linalg.norm(volume)
        volume = shrink(np.asarray(volume, np.float32)) * within
        size = float(np.linalg.norm(volume))
    return size


if __name__ == "__main__":
    main()
