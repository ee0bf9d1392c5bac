"""What docs/twin.md says of the twin, in figures: python benchmarks/digital_twin.py [--plan PLAN.h5] WHAT ...

The part is the sample's, scaled to 12 mm; planning it takes three minutes, unless --plan names where it is kept.
"""

from __future__ import annotations

import argparse
import copy
import os
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import igl
import numpy as np
from scipy.special import expit

from vialight.commands import PlanSettings, plan_part
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.mesh import Mesh
from vialight.core.plan import Plan
from vialight.metrology import sample_surface, unsigned_distance
from vialight.planning.scoring import dose_of_patterns, judged_voxels
from vialight.store import open_frames, read_plan, rig_to_toml
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.twin import Twin, TwinSettings, dose_of, find_rig, grid_round, load_resin, play
from vialight.twin.camera import frames_of, imager_for
from vialight.twin.poses import Pose

SIZE_MM = 12.0
RIG, RESIN = find_rig("orth2022-190"), load_resin("DUDMA")
SAMPLES = 30_000


def planned(path: Path, settings: PlanSettings | None = None) -> Plan:
    """Read the plan, or make it: by default `vialight plan --voxel 0.1 --ceiling 1`."""
    if not path.exists():
        part = Path(str(files("vialight") / "commands" / "sample" / "part.stl"))
        rig = path.with_suffix(".toml")
        rig.write_text(rig_to_toml(RESIN.in_vial_of(RIG)), encoding="utf-8")
        scale = float(SIZE_MM / load_mesh(part).extents_mm.max())
        settings = replace(settings or PlanSettings(voxel_mm=0.1, ceiling=1.0), scale=scale)
        plan_part(part, rig, path, settings=settings, page=False)
    return read_plan(path)


def distances_mm(of: Mesh, to: Mesh) -> tuple[float, float, float]:
    """Return root mean square, 95th percentile and largest distance of points spread over one surface to another."""
    samples = sample_surface(of, SAMPLES)
    distance = unsigned_distance(samples.points_mm, to)
    rms = float(np.sqrt(np.average(distance**2, weights=samples.weights_mm2)))
    return rms, float(np.percentile(distance, 95)), float(distance.max())


class Stop(NamedTuple):
    """A finished print, dark cure included, whose light went off at a certain time."""

    turns_lit: float
    print_to_design_mm: float
    """Root mean square."""
    design_to_print_mm: float
    volume_share: float

    @property
    def rmse_mm(self) -> float:
        """The larger of both ways: one alone does not see what is missing, or what is too much."""
        return max(self.print_to_design_mm, self.design_to_print_mm)


def sweep(
    twin: Twin, plan: Plan, *, stops_a_turn: float = 2.0, longest_turns: float = 60.0, from_share: float = 0.8
) -> Iterator[Stop]:
    """Print, and branch off a print that stops here, from when most will gel until much too much has."""
    design, best = plan.reference, np.inf
    turn_s = 360 / twin.rig.stage.speed_deg_s
    rate_hz = stops_a_turn / turn_s
    for _ in play(twin, plan.patterns, turns=longest_turns, dark_turns=0.0, frame_rate_hz=rate_hz):
        if twin.volume_to_gel_mm3 < from_share * design.volume_mm3:
            continue
        stopped = copy.deepcopy(twin)
        stopped.show(None)
        stopped.advance(turn_s)
        surface = stopped.surface()
        there, back = distances_mm(surface, design)[0], distances_mm(design, surface)[0]
        stop = Stop(twin.time_s / turn_s, there, back, surface.volume_mm3 / design.volume_mm3)
        yield stop
        best = min(best, stop.rmse_mm)
        if stop.rmse_mm > 2.5 * best:
            return


def stops(plan: Plan) -> None:
    """Print deviations of the finished print over the time at which the light goes off."""
    design = plan.reference
    twin = Twin(RIG, RESIN, grid_round(design, 0.1), TwinSettings(binning=8))
    print(f"Part of {design.extents_mm.max():.2f} mm, {len(plan.patterns.levels)} patterns, voxels of 0.1 mm.\n")
    print("| turns lit | print to design, RMS mm | design to print, RMS mm | larger of both | volume, % of design |")
    print("| ---: | ---: | ---: | ---: | ---: |")
    for stop in sweep(twin, plan):
        figures = (stop.print_to_design_mm, stop.design_to_print_mm, stop.rmse_mm)
        line = " | ".join(f"{figure:.3f}" for figure in figures)
        print(f"| {stop.turns_lit:.1f} | {line} | {100 * stop.volume_share:.1f} |", flush=True)


def finer(plan: Plan) -> None:
    """Print by how much half the voxel and half the step move the gelled surface, on the flat end of the part."""
    projector = RIG.need_projector()
    bright = projector.model_copy(update={"irradiance_mw_per_cm2": 4 * (projector.irradiance_mw_per_cm2 or 0.0)})
    rig = RIG.model_copy(update={"projector": bright})
    low, high = plan.reference.bounds_mm
    across = 2 * int(np.ceil(np.abs([low[:2], high[:2]]).max() + 1))
    surfaces = []
    for voxel, step in ((0.1, 1.0), (0.05, 0.5)):
        cells = round(across / voxel)
        # The lower end and a millimetre of resin under it: 3 mm that hold a flat face, walls and corners.
        grid = Grid((round(3.0 / voxel), cells, cells), voxel, float(low[2]) + 0.5)
        twin = Twin(rig, RESIN, grid, TwinSettings(binning=8, chemistry_step_s=step))
        for _ in play(twin, plan.patterns, turns=10.5, dark_turns=1.0, frame_rate_hz=RIG.stage.speed_deg_s / 360):
            pass
        surfaces.append(twin.surface())
    print("| from | to | RMS, um | 95 % within, um | largest, um |\n| --- | --- | ---: | ---: | ---: |")
    for name, pair in (("0.1 mm, 1 s | 0.05 mm, 0.5 s", surfaces), ("0.05 mm, 0.5 s | 0.1 mm, 1 s", surfaces[::-1])):
        figures = " | ".join(f"{1000 * value:.1f}" for value in distances_mm(*pair))
        print(f"| {name} | {figures} |")


def judge(plan: Plan) -> None:
    """Print how far the twin's dose is from that of the planner's own judge, and that both converge."""
    rig, grid = plan.rig, plan.grid
    judged = np.broadcast_to(judged_voxels(grid), grid.shape)
    inside = plan.target >= 0.5
    known = dose_of_patterns(plan.patterns, rig, grid)
    print(
        "| points a voxel, angles a pattern | RMS | RMS inside | slices away from flat ends, median RMS | worst slice |"
    )
    print("| --- | ---: | ---: | ---: | ---: |")
    worst = 0
    for points, angles in (((1, 1, 1), 1), ((1, 3, 3), 3), ((3, 3, 3), 3)):
        off = dose_of(plan.patterns, rig, grid, points_a_voxel=points, angles_a_pattern=angles) - known
        slices = np.sqrt(np.mean(off[:, judged[0]] ** 2, axis=1))
        worst = int(slices.argmax())
        figures = [
            np.sqrt(np.mean(off[judged] ** 2)),
            np.sqrt(np.mean(off[inside] ** 2)),
            np.median(slices),
            slices[worst],
        ]
        print(f"| {points}, {angles} | " + " | ".join(f"{100 * figure:.2f} %" for figure in figures) + " |", flush=True)
    print(f"\nSlice {worst}, of a flat end, with the judge's voxels made finer and averaged again:\n")
    across = grid.shape[1]
    averaged = dose_of(
        plan.patterns, rig, Grid((1, across, across), grid.voxel_mm, float(grid.z_mm[worst])),
        points_a_voxel=(3, 3, 3), angles_a_pattern=3,
    )  # fmt: skip
    for split in (1, 2, 3):
        fine = Grid((split, across * split, across * split), grid.voxel_mm / split, float(grid.z_mm[worst]))
        dose = dose_of_patterns(plan.patterns, rig, fine, subvoxels=3 if split == 1 else 2)
        mean = dose.reshape(1, split, across, split, across, split).mean(axis=(1, 3, 5))
        off = (averaged - mean)[0][judged[0]]
        print(f"- voxels of {fine.voxel_mm:.3f} mm: {100 * np.sqrt(np.mean(off**2)):.2f} % RMS", flush=True)


def cases(folder: Path) -> None:
    """Print how well frames of the shared cases are met, every pixel of every frame, in units of their noise."""
    print("| case | chi-square a pixel | by 2 x 2 rays a pixel | by thin rays, where there is no part |")
    print("| --- | ---: | ---: | ---: |")
    for case in ("part", "cylinder"):
        rig, mesh = load_rig(folder / case / "rig.toml"), load_mesh(folder / case / "truth.stl")
        with open_frames(folder / case / "frames.h5") as recording:
            frames, stray = recording.read(slice(None)).astype(np.float32), recording.dark()
            poses = [Pose(float(angle)) for angle in recording.angles_rad]
        assert stray is not None
        low, high = mesh.bounds_mm
        cells = 2 * int(np.ceil((np.abs([low[:2], high[:2]]).max() + 0.6) / 0.05))
        grid = Grid((int((high[2] - low[2] + 1.2) / 0.05), cells, cells), 0.05, float(low[2] + high[2]) / 2)
        density, camera, figures = soft_part(mesh, grid), rig.need_camera(), []
        for rays in (1, 2):
            imager = imager_for(rig, frames.shape[1:], rays_a_side=rays)
            expected = frames_of(density, grid, imager, poses)
            edge = imager.optics.outer_radius_mm / np.cos(
                np.arcsin(imager.optics.outer_radius_mm / imager.optics.distance_mm)
            )
            x_c = np.abs(np.arange(frames.shape[2]) - camera.axis_column) * camera.pixel_mm
            chi = (frames - expected - stray) ** 2 / (expected + stray + 9)
            seen = np.broadcast_to(x_c < 0.97 * edge, chi.shape)
            figures.append((chi[seen].mean(), chi[seen & (expected < 1e-3)].mean()))
        print(f"| {case} | {figures[0][0]:.3f} | {figures[1][0]:.3f} | {figures[0][1]:.3f} |", flush=True)


def soft_part(mesh: Mesh, grid: Grid) -> Float32Array:
    """Return the density (y, x, z) of the shared cases: half of 200 on the surface, soft over 0.2 mm."""
    distance = np.empty((grid.shape[1], grid.shape[2], grid.shape[0]), np.float32)
    x, z = np.meshgrid(grid.x_mm, grid.z_mm, indexing="ij")
    for layer, y in zip(distance, grid.y_mm, strict=True):
        layer[:] = _signed_distance(np.stack([x, np.full_like(x, y), z], axis=-1).reshape(-1, 3), mesh).reshape(x.shape)
    return np.asarray(200 * expit(-4 * distance / 0.2), dtype=np.float32)


def _signed_distance(points: FloatArray, mesh: Mesh) -> FloatArray:
    kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
    return np.asarray(igl.signed_distance(points, mesh.vertices_mm, mesh.faces, sign_type=kind)[0])


def speed(plan: Plan) -> None:
    """Print how long one turn takes, 18 s in reality: light, chemistry and 180 frames."""
    print(f"{os.cpu_count()} cores, load of the last minute {os.getloadavg()[0]:.1f} before the run.\n")
    print("| voxels | patterns | pixels | before anything scatters, s (of processor) | when all of the grid does, s |")
    print("| --- | ---: | --- | ---: | ---: |")
    for voxel, every, binning in ((0.1, 1, 1), (0.1, 2, 1), (0.2, 2, 1), (0.2, 2, 8)):
        patterns = replace(
            plan.patterns, levels=plan.patterns.levels[::every], angles_rad=plan.patterns.angles_rad[::every]
        )
        twin = Twin(RIG, RESIN, grid_round(plan.reference, voxel), TwinSettings(binning=binning))
        times = []
        for conversion in (0.0, 0.0, 0.2):  # the first compiles
            twin.state = replace(twin.state, conversion=np.full_like(twin.state.conversion, conversion))
            started, busy = time.perf_counter(), time.process_time()
            for _ in play(twin, patterns, turns=1.0, dark_turns=0.0):
                pass
            times.append(f"{time.perf_counter() - started:.1f} ({time.process_time() - busy:.1f})")
        grid = " x ".join(map(str, twin.grid.shape))
        pixels = " x ".join(map(str, twin.image_shape))
        print(f"| {voxel} mm, {grid} | {len(patterns.levels)} | {pixels} | {times[1]} | {times[2]} |", flush=True)


def main() -> None:
    """Run what is asked for."""
    of_plan: dict[str, Callable[[Plan], None]] = {"stops": stops, "finer": finer, "judge": judge, "speed": speed}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="+", choices=[*of_plan, "cases"])
    parser.add_argument("--plan", type=Path, default=Path(tempfile.gettempdir()) / "vialight-benchmark-12mm.h5")
    parser.add_argument("--cases", type=Path, default=Path(__file__).parents[2] / "shared" / "cases")
    chosen = parser.parse_args()
    for what in chosen.what:
        print(f"\n## {what}\n")
        if what == "cases":
            cases(chosen.cases)
        else:
            of_plan[what](planned(chosen.plan))


if __name__ == "__main__":
    main()
