"""How far surfaces are from the truth of the shared cases: python benchmarks/accuracy.py [--cases DIR]."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path

import numpy as np

from vialight.core.mesh import Mesh
from vialight.metrology import sample_surface, signed_distance, unsigned_distance
from vialight.metrology.surface import isosurface, pieces
from vialight.store import open_frames
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Scan, Settings, open_scan, reconstruct

THRESHOLD = 100.0
SETTINGS = {
    "default": Settings(),
    "accurate": Settings(accurate=True),
    "hann": Settings(filter_name="hann"),
    "shepp-logan": Settings(filter_name="shepp-logan"),
    "ram-lak": Settings(filter_name="ram-lak"),
    "2 x 2 pixels": Settings(binning=2),
}


def main() -> None:
    """Print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=Path, default=Path(__file__).parents[2] / "shared" / "cases")
    cases = parser.parse_args().cases
    print("| case | frames | settings | RMS, um | mean, um | truth within 0.1 mm, % | pieces |")
    print("| --- | --- | --- | ---: | ---: | ---: | ---: |")
    for case in ("part", "cylinder"):
        truth = load_mesh(cases / case / "truth.stl")
        for name, settings in SETTINGS.items():
            print_row(cases / case, truth, name, settings, "all")
        for lost in ("10 % missing", "15 deg missing"):
            print_row(cases / case, truth, "default", Settings(), lost)


def print_row(folder: Path, truth: Mesh, name: str, settings: Settings, frames: str) -> None:
    """Reconstruct once and print how far the surface is off."""
    with open_frames(folder / "frames.h5") as recording:
        scan = without(open_scan(recording, load_rig(folder / "rig.toml"), settings), frames)
        surface = isosurface(reconstruct(scan, settings), THRESHOLD * settings.binning**2)
    print_samples, true_samples = sample_surface(surface), sample_surface(truth)
    off = signed_distance(print_samples.points_mm, truth)
    missed = unsigned_distance(true_samples.points_mm, surface)
    weights, true_weights = print_samples.weights_mm2, true_samples.weights_mm2
    rms, mean = np.sqrt(np.average(off**2, weights=weights)), np.average(off, weights=weights)
    within = np.average(missed <= 0.1, weights=true_weights)
    large = int((np.abs(pieces(surface)) > 1).sum())
    print(
        f"| {folder.name} | {frames} | {name} | {1e3 * rms:.1f} | {1e3 * mean:.1f} | {100 * within:.2f} | {large} |",
        flush=True,
    )


def without(scan: Scan, frames: str) -> Scan:
    """Leave frames out of a turn."""
    count = len(scan.chosen)
    keep = np.ones(count, dtype=bool)
    if frames == "10 % missing":
        keep[np.random.default_rng(0).choice(count, count // 10, replace=False)] = False
    elif frames == "15 deg missing":
        keep[40:48] = False
    return dataclasses.replace(scan, chosen=scan.chosen[keep], angles_rad=scan.angles_rad[keep])


if __name__ == "__main__":
    main()
