"""Axis, tilt, run-out and turning sense, found to what the issue asks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibration.wobbling import AXIS_COLUMN, PIXEL_MM, RIG, Recorded, axis_found, part
from vialight.calibration.axis.estimator import AxisFit, find_axis, symmetric_centre
from vialight.calibration.opposite_sums import AXIS, OUT_X, OUT_Y, TILT
from vialight.calibration.usable_frames import rows_to_compare
from vialight.core.arrays import Grid
from vialight.core.config import Rig, RunOut
from vialight.core.errors import InputError
from vialight.metrology.distance import sample_surface
from vialight.metrology.surface import isosurface
from vialight.store import open_frames, write_frames
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Settings, open_scan, reconstruct


def test_axis_tilt_and_run_out_are_found_from_a_rig_four_columns_off(wobbling_axis: AxisFit) -> None:
    values = wobbling_axis.fit.parameters
    assert values[AXIS] == pytest.approx(AXIS_COLUMN, abs=0.03)
    # At a height of 10 mm 5 um, by which a reconstruction may be worse than one without faults.
    assert values[TILT] == pytest.approx(0.005, abs=0.005 / 10)
    assert values[OUT_X : OUT_Y + 1] == pytest.approx([0.15, 0.0], abs=0.05 * PIXEL_MM)
    assert wobbling_axis.determined.all()
    assert wobbling_axis.fit.comparison.rms < 0.2 * wobbling_axis.before.rms


def test_the_turning_sense_is_found(wobbling_axis: AxisFit) -> None:
    assert wobbling_axis.direction == -1


def test_stated_uncertainties_cover_the_truth_without_the_edges_too(wobbling: Recorded) -> None:
    """A short form of the table that benchmarks/calibrations.py prints."""
    truth = np.array([AXIS_COLUMN, 0.005, 0.15, 0.0])
    inside = []
    for seed in (10, 11):
        fit = axis_found(wobbling, seed=seed, edges=False).fit
        inside.append(np.abs(fit.parameters[:4] - truth) <= 1.96 * fit.std[:4])
        assert fit.parameters[OUT_X : OUT_Y + 1] == pytest.approx([0.15, 0.0], abs=0.05 * PIXEL_MM)
    assert np.mean(inside) >= 7 / 8


def test_jitter_of_the_angles_is_found_and_else_nothing_where_nothing_is_wrong(still: Recorded) -> None:
    jitter = np.random.default_rng(5).normal(0, np.radians(0.2), len(still.angles_rad))
    found = axis_found(still._replace(angles_rad=still.angles_rad + jitter), off=-0.3 / PIXEL_MM)
    assert np.degrees(found.jitter.std_rad) == pytest.approx(0.2, abs=0.07)
    values, std = found.fit.parameters, found.fit.std
    assert values[AXIS] == pytest.approx(RIG.need_camera().axis_column, abs=0.03)
    assert np.hypot(*values[OUT_X : OUT_Y + 1]) < 3 * std[OUT_X]


@pytest.mark.parametrize(("case", "direction"), [("part", 1), ("cylinder", None)])
def test_the_shared_cases_have_their_axis_found(shared_cases: Path, case: str, direction: int | None) -> None:
    """A cylinder about the axis looks the same turned either way."""
    rig = load_rig(shared_cases / case / "rig.toml")
    camera, optics = rig.need_camera(), rig.imaging_optics()
    off = camera.model_copy(update={"axis_column": camera.axis_column + 4.0})
    with open_frames(shared_cases / case / "frames.h5") as frames:
        dark = frames.dark()
        assert dark is not None
        raw = frames.read(slice(None)).astype(np.float32)
        counts, angles = raw - dark.astype(np.float32), frames.angles_rad
    rows = rows_to_compare(counts.mean(axis=(0, 2), dtype=np.float64), off, optics)
    found = find_axis(
        counts[:, rows], rows.start, angles, off, optics, profiles=raw[:, rows].mean(axis=1, dtype=np.float64)
    )
    assert found.fit.parameters[AXIS] == pytest.approx(camera.axis_column, abs=0.03)
    assert found.direction == direction
    assert np.hypot(*found.fit.parameters[OUT_X : OUT_Y + 1]) < 0.05 * camera.pixel_mm
    assert found.circle is not None
    assert found.circle.middle == pytest.approx(87.5, abs=0.05)  # these streaks are drawn about the image's middle


def rms_mm(recording: Recorded, rig: Rig, folder: Path) -> float:
    path = folder / f"{len(list(folder.iterdir()))}.h5"
    write_frames(path, recording.counts(3), recording.angles_rad, dark=recording.dark(3))
    settings = Settings(voxel_mm=0.1)
    with open_frames(path) as frames:
        volume = reconstruct(open_scan(frames, rig, settings), settings, grid=Grid((36, 120, 120), 0.1))
    samples = sample_surface(isosurface(volume, 100.0), 20_000)
    sides = np.abs(samples.points_mm[:, 2]) < 1.5
    distance = part(*samples.points_mm.T)[sides]
    return float(np.sqrt(np.average(distance**2, weights=samples.weights_mm2[sides])))


def test_a_reconstruction_with_what_was_found_is_as_good_as_without_faults(
    wobbling: Recorded, wobbling_axis: AxisFit, still: Recorded, tmp_path: Path
) -> None:
    found = wobbling_axis.fit.parameters
    camera = RIG.need_camera().model_copy(
        update={"axis_column": float(found[AXIS]), "axis_tilt_deg": float(np.degrees(found[TILT]))}
    )
    phase = float(np.degrees(np.arctan2(found[OUT_Y], found[OUT_X])))
    run_out = RunOut(radius_mm=float(np.hypot(found[OUT_X], found[OUT_Y])), phase_deg=phase)
    calibrated = RIG.model_copy(update={"camera": camera, "stage": RIG.stage.model_copy(update={"run_out": run_out})})
    without = rms_mm(still, RIG, tmp_path)
    assert rms_mm(wobbling, calibrated, tmp_path) < without + 0.005
    ignored = calibrated.model_copy(update={"stage": RIG.stage})
    assert rms_mm(wobbling, ignored, tmp_path) > without + 0.02  # so the run-out does matter


def test_an_axis_that_is_nowhere_near_is_refused() -> None:
    column = np.arange(176)
    with pytest.raises(InputError, match="opposite views agree nowhere within 12 columns of axis_column 60"):
        symmetric_centre(np.exp(-(((column - 90) / 20.0) ** 2)), 60.0)
