"""`vialight calibrate axis`: what it writes, and what it refuses, with a picture."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.wobbling import AXIS_COLUMN, PIXEL_MM, RIG, Recorded
from vialight.commands.calibrate import calibrate_axis, calibrate_vial
from vialight.core.errors import InputError
from vialight.store import rig_to_toml, write_frames
from vialight.store.rig_files import load_rig


@pytest.fixture
def rig_path(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(rig_to_toml(RIG), encoding="utf-8")
    return path


def test_a_new_rig_with_its_page_is_written(wobbling: Recorded, rig_path: Path, tmp_path: Path) -> None:
    write_frames(tmp_path / "frames.h5", wobbling.counts(0), wobbling.angles_rad, dark=wobbling.dark(0))
    result = calibrate_axis(tmp_path / "frames.h5", rig_path, tmp_path / "new.toml")
    rig = load_rig(tmp_path / "new.toml")
    assert rig.need_camera().axis_column == pytest.approx(AXIS_COLUMN, abs=0.03)
    assert rig.stage.run_out is not None
    assert rig.stage.run_out.radius_mm == pytest.approx(0.15, abs=0.05 * PIXEL_MM)
    assert rig.uncertainty is not None
    assert rig.uncertainty.camera is not None
    assert 0 < rig.uncertainty.camera["axis_column"] < 0.03
    assert result["details"]["rms_of_opposite_views_after_counts"] < 20
    page = (tmp_path / "new.html").read_text(encoding="utf-8")
    assert page.count("data:image/png") == 3


def test_an_angle_zero_that_moves_from_turn_to_turn_is_told(still: Recorded, rig_path: Path, tmp_path: Path) -> None:
    """Three turns of a part that goes on curing, whose stage gains a tenth of a degree in each."""
    turns = [still._replace(part=still.part * gain).counts(seed) for seed, gain in enumerate((0.6, 0.9, 1.0))]
    gained = np.radians(0.1)
    angles = np.concatenate([still.angles_rad + turn * (2 * np.pi - gained) for turn in range(3)])
    write_frames(tmp_path / "frames.h5", np.concatenate(turns), angles, dark=still.dark(0))
    result = calibrate_axis(tmp_path / "frames.h5", rig_path, tmp_path / "new.toml")
    details = result["details"]
    drift, std = details["angle_zero_drift_deg_a_turn"], details["angle_zero_drift_deg_a_turn_std"]
    assert set(details["angle_zero_moved_deg"]) == {"2", "3"}
    assert abs(drift - 0.1) < 3 * std < 0.05
    assert any("farther on with every turn" in note for note in result["notes"])


def refused(
    calibrate: Callable[..., object], frames: NDArray[np.uint16], angles: NDArray[np.float64], recording: Recorded,
    rig_path: Path, match: str,
) -> None:  # fmt: skip
    folder = rig_path.parent
    write_frames(folder / "frames.h5", frames, angles, dark=recording.dark(0))
    with pytest.raises(InputError, match=match):
        calibrate(folder / "frames.h5", rig_path, folder / "new.toml")
    assert (folder / "new.refused.png").stat().st_size > 1000
    assert not (folder / "new.toml").exists()


both = pytest.mark.parametrize("calibrate", [calibrate_axis, calibrate_vial])


@both
def test_half_a_turn_is_refused_with_a_picture(
    calibrate: Callable[..., object], still: Recorded, rig_path: Path
) -> None:
    match = r"no frames for 180\.0 deg"
    refused(calibrate, still.counts(0)[:91], still.angles_rad[:91], still, rig_path, match)


@both
def test_frames_with_nothing_cured_are_refused_with_a_picture(
    calibrate: Callable[..., object], still: Recorded, rig_path: Path
) -> None:
    empty = still._replace(part=np.zeros_like(still.part))
    refused(calibrate, empty.counts(0), still.angles_rad, still, rig_path, "nothing has cured")


@both
def test_saturated_frames_are_refused_with_a_picture(
    calibrate: Callable[..., object], still: Recorded, rig_path: Path
) -> None:
    dim = np.minimum(still.counts(0), np.uint16(300))
    refused(calibrate, dim, still.angles_rad, still, rig_path, "the image is saturated")
