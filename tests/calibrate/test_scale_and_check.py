"""The scale by the vial's edges; the check of a run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calibrate.wobbling import AXIS_COLUMN, PIXEL_MM, RIG, Recorded
from vialight.commands.calibrating import calibrate_scale, check_calibration
from vialight.config import Rig, load_rig
from vialight.errors import InputError
from vialight.store import rig_to_toml, write_frames


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


def test_a_run_tells_that_its_calibration_is_no_longer_good(
    wobbling: Recorded, still: Recorded, tmp_path: Path
) -> None:
    rig_file(tmp_path, RIG)
    write_frames(tmp_path / "frames.h5", still.counts(0), still.angles_rad, dark=still.dark(0))
    assert check_calibration(tmp_path)["good"]
    (tmp_path / "frames.h5").unlink()
    write_frames(tmp_path / "frames.h5", wobbling.counts(0), wobbling.angles_rad, dark=wobbling.dark(0))
    result = check_calibration(tmp_path)
    changed = {check["what"] for check in result["checks"] if not check["good"]}
    assert changed == {"axis", "change of the run-out"}
