"""The scale by the vial's edges; the check of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calibration.wobbling import AXIS_COLUMN, PIXEL_MM, RIG, Recorded
from vialight.commands.calibrate import calibrate_scale, check_calibration
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.store import rig_to_toml, write_frames
from vialight.store.rig_files import load_rig


def rig_file(folder: Path, rig: Rig) -> Path:
    path = folder / "rig.toml"
    path.write_text(rig_to_toml(rig), encoding="utf-8")
    return path


def test_a_pixel_is_measured_by_the_vials_edges(wobbling: Recorded, tmp_path: Path) -> None:
    write_frames(tmp_path / "frames.h5", wobbling.counts(0), wobbling.angles_rad)
    camera = RIG.need_camera().model_copy(update={"pixel_mm": 0.151, "axis_column": AXIS_COLUMN})
    wrong = rig_file(tmp_path, RIG.model_copy(update={"camera": camera}))
    calibrate_scale(tmp_path / "frames.h5", wrong, tmp_path / "new.toml", diameter_mm=24.8)
    rig = load_rig(tmp_path / "new.toml")
    assert rig.need_camera().pixel_mm == pytest.approx(PIXEL_MM, rel=2e-3)
    assert rig.uncertainty is not None
    assert rig.uncertainty.camera is not None
    assert abs(rig.need_camera().pixel_mm - PIXEL_MM) < 2 * rig.uncertainty.camera["pixel_mm"]


def test_edges_that_do_not_show_are_refused_with_a_picture(still: Recorded, tmp_path: Path) -> None:
    plain = still._replace(stray=np.full_like(still.stray, 45))
    write_frames(tmp_path / "frames.h5", plain.counts(0), plain.angles_rad)
    with pytest.raises(InputError, match="left and right edge does not show"):
        calibrate_scale(tmp_path / "frames.h5", rig_file(tmp_path, RIG), tmp_path / "new.toml", diameter_mm=24.8)
    assert (tmp_path / "new.refused.png").exists()


def run_of(folder: Path, recording: Recorded, rig: Rig = RIG, *, blur: float = 0.0, light: float = 1.0) -> Path:
    """Write a run's folder, of a camera that is out of focus, or of another light."""
    folder.mkdir()
    rig_file(folder, rig)
    frames, dark = (
        gaussian_filter(light * counts.astype(np.float64), (0, blur, blur)).astype(np.uint16)
        for counts in (recording.counts(0), recording.dark(0))
    )
    write_frames(folder / "frames.h5", frames, recording.angles_rad, dark=dark, settings={"exposure_s": 0.02})
    return folder


def changed(result: dict[str, Any]) -> set[str]:
    return {check["what"] for check in result["checks"] if not check["good"]}


def test_a_run_tells_that_its_calibration_is_no_longer_good(
    wobbling: Recorded, still: Recorded, tmp_path: Path
) -> None:
    result = check_calibration(run_of(tmp_path / "still", still))
    assert result["good"]
    assert any("no [reference]" in note for note in result["notes"])
    result = check_calibration(run_of(tmp_path / "wobbling", wobbling))
    assert changed(result) == {"axis", "change of the run-out"}
    page = (tmp_path / "wobbling" / "check.html").read_text()
    assert "CHANGED" in page
    assert "the vial sits differently" in page
    assert page.count("data:image/png") == 3


SHARPNESS = {"width of the light at the vial's edges", "softness of the part's edges"}
LIGHT = {"light at the vial's edges"}


def test_lost_focus_and_another_light_are_told_by_a_run_that_was_good(still: Recorded, tmp_path: Path) -> None:
    """The kept run, one like it, one out of focus by 0.4 mm on the axis, and one whose light is 20 % weaker."""
    kept = check_calibration(run_of(tmp_path / "good", still), out=tmp_path / "kept.toml")
    assert kept["good"]
    rig = load_rig(tmp_path / "kept.toml")
    assert rig.reference is not None
    assert rig.reference.streak_columns == pytest.approx(0.3 / PIXEL_MM, rel=0.1)  # as the twin's stray light has it
    assert rig.reference.streak_counts == pytest.approx(60.0 * np.sqrt(2 * np.pi) * 0.3 / PIXEL_MM, rel=0.1)
    again = run_of(tmp_path / "again", still._replace(part=still.part[::-1], angles_rad=-still.angles_rad[::-1]), rig)
    assert not changed(check_calibration(again)) & (SHARPNESS | LIGHT)
    blurred = check_calibration(run_of(tmp_path / "blurred", still, rig, blur=0.4 / PIXEL_MM))
    assert changed(blurred) >= SHARPNESS
    assert not changed(blurred) & LIGHT
    dim = check_calibration(run_of(tmp_path / "dim", still, rig, light=0.8))
    assert changed(dim) == LIGHT
