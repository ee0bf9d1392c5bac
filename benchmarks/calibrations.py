"""How true calibrations are, and whether their uncertainties cover it: python benchmarks/calibrations.py PART."""

from __future__ import annotations

import argparse
import shutil
import sys
import tempfile
from collections.abc import Callable
from importlib.resources import files
from pathlib import Path

import numpy as np
from scipy.special import expit

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))

from calibration.flat_targets import CAMERA, IN_AIR, IN_VIAL, Target, picture
from calibration.test_flat_target import RIG as TARGET_RIG
from calibration.test_gelling import print_runs
from calibration.wobbling import AXIS_COLUMN, THREE, WIDE, Posts, axis_found, recorded, rig_with
from vialight.calibration.projector.command import SweepOptions
from vialight.calibration.scale.flat_target_command import FlatTarget
from vialight.calibration.scale.flat_target_points import Kind
from vialight.calibration.threshold.by_rim import overhead, rim_threshold
from vialight.calibration.threshold.height_maps import circle_in_heights
from vialight.calibration.threshold.standards import Standard, StandardOptions
from vialight.calibration.vial.bending import usual_widths
from vialight.calibration.vial.estimator import find_vial
from vialight.commands.calibrate import (
    calibrate_projector,
    calibrate_resin,
    calibrate_scale_by_target,
    calibrate_threshold,
)
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Camera, Optics, Resin, Rig, Vial
from vialight.store import open_frames, rig_to_toml, write_frames
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Settings, open_scan, reconstruct
from vialight.twin import Faults
from vialight.twin.camera import frames_of, imager_for
from vialight.twin.poses import Pose
from vialight.twin.sensor import Sensor

DRAWS = 100
SWEEPS = 10
HOLDS = 20
VIALS = 16
VIAL_KEYS = ("outer radius, mm", "index", "distance, mm")
RIG_COLUMN = 87.3
"""Of the axis in `calibrate.wobbling`."""

CURED, EDGE_MM = 200.0, 0.2
"""As in the shared cases: half of it at the surface, soft over so much."""
STRAY = 60.0
PROFILE_PIXEL_MM = 0.05
CASES = Path(__file__).parents[2] / "shared" / "cases"


def threshold() -> None:
    """Print whether I_p is covered, and what diameters it gives other cylinders."""
    print(f"I_p of 100 counts per mm from {DRAWS} draws of the noise of frames and profile, pixels of 0.31 mm:\n")
    print("| standard, mm | mean | scatter | stated | within 1.96 stated, % |\n| ---: | ---: | ---: | ---: | ---: |")
    for diameter_mm in (12.0, 6.0):
        found = np.array(_draws(diameter_mm))
        covered = np.abs(found[:, 0] - CURED / 2) < 1.96 * found[:, 1]
        print(
            f"| {diameter_mm:g} | {found[:, 0].mean():.2f} | {found[:, 0].std():.2f} | {found[:, 1].mean():.2f} "
            f"| {100 * covered.mean():.0f} |"
        )
    print("\nDiameters, mm, at the I_p of the shared cylinder:\n")
    print("| cylinder | by profile | by OST | difference |\n| ---: | ---: | ---: | ---: |")
    with tempfile.TemporaryDirectory() as name:
        folder, case = Path(name), CASES / "cylinder"
        others = [_recorded(folder, load_rig(case / "rig.toml"), diameter_mm) for diameter_mm in (3.31, 7.0)]
        result = calibrate_threshold(
            [Standard(case / "frames.h5", case / "heights.npy")], case / "rig.toml", folder / "new.toml",
            options=StandardOptions(PROFILE_PIXEL_MM), validate=others,
        )  # fmt: skip
    for row in result["details"]["validation"]:
        profile, ost = row["profile_diameter_mm"], row["ost_diameter_mm"]
        print(
            f"| {Path(row['frames']).stem} | {profile:.4f} ± {row['profile_std_mm']:.4f} "
            f"| {ost:.4f} ± {row['ost_std_mm']:.4f} | {ost - profile:+.4f} |"
        )
    one = result["details"]["standards"][0]
    print(
        f"\nI_p {one['threshold']:.2f} ± {one['std']:.2f}, spread {one['spread']:.2f} (with the centre at whole voxels "
        f"{one['spread_at_whole_voxels']:.2f}), slope {one['slope_per_mm']:.0f} per mm, edge as if blurred by "
        f"{one['blur_std_mm']:.3f} mm; a diameter error of {one['diameter_std_mm']:.4f} mm."
    )


def _draws(diameter_mm: float) -> list[tuple[float, float]]:
    rig = Rig(
        vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472), resin=Resin(index_imaging=1.48),
        camera=Camera(distance_mm=190.0, pixel_mm=0.31, axis_column=43.5, optical_row=11.5),
    )  # fmt: skip
    angles = np.arange(90, dtype=np.float64) * (2 * np.pi / 90)
    clean = _clean(rig, (24, 88), angles, diameter_mm, voxel_mm=0.08)
    found = []
    with tempfile.TemporaryDirectory() as name:
        for draw in range(DRAWS):
            rng, path = np.random.default_rng(draw), Path(name) / "frames.h5"
            _write(path, clean, angles, rng)
            with open_frames(path) as frames:
                volume = reconstruct(open_scan(frames, rig, Settings()), Settings())
            profile = circle_in_heights(_heights(diameter_mm, rng), PROFILE_PIXEL_MM)
            rim = rim_threshold(overhead(volume.density, volume.grid), profile.radius_mm, profile.radius_std_mm)
            found.append((rim.threshold, rim.std))
    return found


def _recorded(folder: Path, rig: Rig, diameter_mm: float) -> Standard:
    angles = np.arange(180, dtype=np.float64) * (2 * np.pi / 180)
    path, rng = folder / f"{diameter_mm:g}.h5", np.random.default_rng(0)
    _write(path, _clean(rig, (120, 176), angles, diameter_mm, voxel_mm=0.05), angles, rng)
    np.save(path.with_suffix(".npy"), _heights(diameter_mm, rng))
    return Standard(path, path.with_suffix(".npy"))


def _clean(
    rig: Rig, shape: tuple[int, int], angles: FloatArray, diameter_mm: float, *, voxel_mm: float
) -> Float32Array:
    """Return frames without noise of a cylinder 2.4 mm high that stands a little beside the axis."""
    across, high = 2 * int((diameter_mm / 2 + 0.9) / voxel_mm), 2 * int(1.8 / voxel_mm)
    grid = Grid((high, across, across), voxel_mm)
    x, y, z = grid.x_mm[:, None], grid.y_mm[:, None, None], grid.z_mm
    beside, beyond = np.hypot(x - 0.31, y + 0.18) - diameter_mm / 2, np.abs(z) - 1.2
    distance = np.minimum(np.maximum(beside, beyond), 0) + np.hypot(np.maximum(beside, 0), np.maximum(beyond, 0))
    density = np.asarray(CURED * expit(-4 / EDGE_MM * distance), dtype=np.float32)
    return frames_of(density, grid, imager_for(rig, shape), [Pose(float(angle)) for angle in angles])


def _write(path: Path, clean: Float32Array, angles: FloatArray, rng: np.random.Generator) -> None:
    sensor = Sensor()
    dark = sensor.photograph(np.full((8, *clean.shape[1:]), STRAY), rng)
    write_frames(path, sensor.photograph(clean + STRAY, rng), angles, dark=dark)


def _heights(diameter_mm: float, rng: np.random.Generator) -> FloatArray:
    """Return the map of a cylinder that was set down anywhere, with noise and missing pixels."""
    size = int((diameter_mm + 3) / PROFILE_PIXEL_MM)
    row, column = np.mgrid[:size, :size] * PROFILE_PIXEL_MM
    centre = size * PROFILE_PIXEL_MM / 2 + rng.uniform(-0.5, 0.5, 2)
    heights = np.where(np.hypot(column - centre[0], row - centre[1]) < diameter_mm / 2, 10.0, 0.0)
    heights += rng.normal(0, 0.004, heights.shape)
    heights[rng.random(heights.shape) < 0.02] = np.nan
    return np.asarray(heights)


def index() -> None:
    """Print the index found where the rig has 1.49 in place of 1.48."""
    print("Index from the apparent size of cylinders of 1.48, which the rig has at 1.49:\n")
    print("| cylinders, mm | index |\n| --- | ---: |")
    with tempfile.TemporaryDirectory() as name:
        folder, case = Path(name), CASES / "cylinder"
        rig = load_rig(case / "rig.toml")
        (folder / "wrong.toml").write_text((case / "rig.toml").read_text().replace("1.48", "1.49"))
        cylinders = [_recorded(folder, rig, diameter_mm) for diameter_mm in (3.31, 7.0)]
        cylinders.append(Standard(case / "frames.h5", case / "heights.npy"))
        for title, chosen in (("12", cylinders[2:]), ("3.31, 7", cylinders[:2]), ("3.31, 7, 12", cylinders)):
            found = calibrate_resin(
                None, folder / "wrong.toml", folder / "new.toml", cylinders=chosen,
                options=StandardOptions(PROFILE_PIXEL_MM),
            )["found"][0]  # fmt: skip
            print(f"| {title} | {found['value']:.4f} ± {found['uncertainty']:.4f} |")


def projector() -> None:
    """Print what sweeps of the twin find, with one noise after the other."""
    print(f"Projector 4 columns off, on the side that the rig does not have; {SWEEPS} draws of the noise:\n")
    print("| | true | mean | scatter | stated |\n| --- | ---: | ---: | ---: | ---: |")
    found: dict[str, list[tuple[float, float]]] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        faults = "projector_shift_pixels = [4.0, 0.0]\n[believed.projector]\nazimuth_deg = 88.0\npixel_mm = 0.0645\n"
        (folder / "faults.toml").write_text(faults)
        (folder / "rig.toml").write_text((files("vialight.twin.presets") / "rigs/orth2022-190.toml").read_text())
        for seed in range(SWEEPS):
            options = SweepOptions(faults=folder / "faults.toml", seed=seed)
            result = calibrate_projector(folder / "rig.toml", folder / "new.toml", options=options)
            for value in result["found"]:
                found.setdefault(value["key"], []).append((value["value"], value["uncertainty"]))
    for key, true in (("axis_column", 507.5), ("pixel_mm", 0.065), ("azimuth_deg", -90.0), ("absorption_per_mm", 0.08)):
        values, stds = np.array(found[key]).T
        print(f"| {key} | {true:g} | {values.mean():.5g} | {values.std(ddof=1):.2g} | {stds.mean():.2g} |")


def axis() -> None:
    """Print how often the uncertainties of the axis cover the truth, from a rig that is four columns off."""
    recording = recorded(Faults(axis_offset_mm=(0.3, 0.0), run_out_mm=0.15, tilt_rad=(0.005, 0.0)))
    unit = np.array([1.0, np.degrees(1.0), 1.0, 1.0])
    fits = [axis_found(recording, off=-4.0, seed=draw).fit for draw in range(DRAWS)]
    true = (AXIS_COLUMN, 0.005, 0.15, 0.0)  # in the fit's units: the tilt in rad
    rows = zip(("axis, columns", "tilt, deg", "run-out x, mm", "run-out y, mm"), (4, 4, 5, 5), true, strict=True)
    _covered_head()
    for k, (name, digits, truth) in enumerate(rows):
        found = np.array([(fit.parameters[k] - truth, fit.std[k]) for fit in fits]) * unit[k]
        _covered_row(name, found, digits)


def vial() -> None:
    """Print how often radius, index and distance are covered, in rigs whose every value is off."""
    taken = np.array([12.4, 1.48, 190.0, 1.1, 1.472, 0.155])
    usual = usual_widths(taken)
    known = usual * np.array([1.0, 0.05, 1.0, 1.0, 1.0, 0.1])
    _covered_head()
    for name, posts, widths in (
        ("within 5 mm", THREE, usual),
        ("out to 7 mm", WIDE, usual),
        ("index known", WIDE, known),
    ):
        _covered_vial(name, posts, taken, widths)


def _covered_vial(name: str, posts: Posts, taken: FloatArray, widths: FloatArray) -> None:
    """Print rows of those values that were refined; the rigs' true values are off by what `widths` say."""
    found: dict[str, list[tuple[float, float]]] = {}
    for rig in range(VIALS):
        truth = taken + np.random.default_rng(rig).normal(0, widths)
        recording = recorded(Faults(), rig=rig_with(*truth), posts=posts)
        axis = axis_found(recording, off=RIG_COLUMN - AXIS_COLUMN, seed=rig, rig=rig_with(*taken))
        fit = find_vial(axis, widths)
        for key, value, std, true, free in zip(VIAL_KEYS, fit.values, fit.std, truth, fit.free, strict=False):
            if free:
                found.setdefault(key, []).append((value - true, std))
    for key in VIAL_KEYS:
        if key in found:
            _covered_row(f"{name}: {key}", np.array(found[key]), 4)


def scale() -> None:
    """Print how often the uncertainties of a target's scale cover the truth, the target held anew each time."""
    rocked = (-20.0, 0.0, 20.0)
    views: tuple[tuple[str, Kind, Optics, tuple[float, ...]], ...] = (
        ("dots in air", "dots", IN_AIR, rocked),
        ("chessboard in air", "chessboard", IN_AIR, rocked),
        ("dots in air, one position", "dots", IN_AIR, rocked[1:2]),
        ("dots in the vial, one position", "dots", IN_VIAL, rocked[1:2]),
    )
    _covered_head()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "rig.toml").write_text(rig_to_toml(TARGET_RIG))
        for title, kind, optics, turned_deg in views:
            found: dict[str, list[tuple[float, float]]] = {}
            for draw in range(HOLDS):
                rng = np.random.default_rng(draw)
                target = Target(
                    kind,
                    1.5,
                    rng.normal(0, 0.3),
                    rng.normal(0, 2.0),
                    rng.normal(0, 2.0),
                    rng.normal(0, 2.0),
                    (rng.random(), rng.random()),
                )
                seen = [
                    picture(target, optics, turned_deg=angle, seed=draw + 1000 * k)
                    for k, angle in enumerate(turned_deg)
                ]
                write_frames(folder / "frames.h5", np.stack(seen), np.radians(turned_deg))
                result = calibrate_scale_by_target(
                    folder / "frames.h5", folder / "rig.toml", folder / "new.toml",
                    FlatTarget(kind, 1.5, 0.0, optics is IN_VIAL),
                )  # fmt: skip
                (folder / "frames.h5").unlink()
                for one in result["found"]:
                    found.setdefault(one["key"], []).append(
                        (one["value"] - getattr(CAMERA, one["key"]), one["uncertainty"])
                    )
            for key, values in found.items():
                if len(values) < HOLDS / 2:  # mostly left alone
                    continue
                _covered_row(f"{title}: {key}", np.array(values), 6 if key == "pixel_mm" else 3)


def gelling() -> None:
    """Print the critical exposure by gel times, of one print and of two."""
    print("| runs | gel times | critical, mJ/cm^2 | gels later by, s |\n| --- | --- | ---: | ---: |")
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        print_runs(folder)
        for source in ("the twin's", "seen in frames"):
            if source != "the twin's":
                for run in ("slow", "fast"):
                    shutil.rmtree(folder / run / "gel_time.zarr")
            for runs in (["slow"], ["fast"], ["slow", "fast"]):
                result = calibrate_resin(
                    None, folder / "slow" / "rig.toml", folder / "new.toml", runs=[folder / run for run in runs],
                    options=StandardOptions(settings=Settings(voxel_mm=0.6)),
                )  # fmt: skip
                found, lag_s = result["found"][0], result["details"]["gels_later_by_s"]
                late = "-" if lag_s is None else f"{lag_s:.1f}"
                print(f"| {', '.join(runs)} | {source} | {found['value']:.0f} ± {found['uncertainty']:.0f} | {late} |")


def _covered_head() -> None:
    print("| | draws | mean error | scatter | stated | largest error | covered at 95 % |")
    print("| --- | ---: | ---: | ---: | ---: | ---: | ---: |")


def _covered_row(name: str, found: FloatArray, digits: int) -> None:
    """Print what errors and their standard uncertainties, (draw, 2), say."""
    error, stated = found.T
    figures = (error.mean(), error.std(ddof=1), stated.mean(), np.abs(error).max())
    text = " | ".join(f"{figure:.{digits}f}" for figure in figures)
    share = 100 * np.mean(np.abs(error) <= 1.96 * stated)
    print(f"| {name} | {len(error)} | {text} | {share:.0f} % |", flush=True)


PARTS: dict[str, Callable[[], None]] = {
    "axis": axis, "gelling": gelling, "index": index, "projector": projector, "scale": scale, "threshold": threshold,
    "vial": vial,
}  # fmt: skip


def main() -> None:
    """Print tables in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("part", choices=sorted(PARTS))
    PARTS[parser.parse_args().part]()


if __name__ == "__main__":
    main()
