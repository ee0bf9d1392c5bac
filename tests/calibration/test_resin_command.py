"""A calibration writes a rig that keeps all that it did not find, and says what it found and how well."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vialight.cli import main
from vialight.commands.calibrate import calibrate_resin
from vialight.core.errors import InputError
from vialight.store import sha256_of
from vialight.store.rig_files import load_rig
from vialight.twin import find_rig

RIG = """# Our printer, second floor
schema = 1

[vial]
outer_radius_mm = 12.4   # callipers, 3 November

[resin]
name = "DUDMA"
absorption_per_mm = 0.07 # a guess
"""


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(RIG)
    return path


@pytest.fixture
def depths(tmp_path: Path) -> Path:
    path = tmp_path / "depths.csv"
    lines = [f"{dose}, {12.0 * np.log(dose / 30.0):.5f}, fine" for dose in (50.0, 100.0, 200.0, 400.0)]
    path.write_text("\n".join(["exposure_mj_per_cm2, depth_mm, remark", *lines]))
    return path


def test_comments_and_all_that_was_not_found_stay(rig: Path, depths: Path, tmp_path: Path) -> None:
    result = calibrate_resin(depths, rig, tmp_path / "new.toml")
    text = (tmp_path / "new.toml").read_text()
    for kept in ("# Our printer, second floor", "# callipers, 3 November", "# a guess", 'name = "DUDMA"'):
        assert kept in text
    assert rig.read_text() == RIG
    new = load_rig(tmp_path / "new.toml")
    assert new.resin.absorption_per_mm == pytest.approx(1 / 12.0, rel=1e-4)
    assert new.resin.critical_exposure_mj_per_cm2 == pytest.approx(30.0, rel=1e-4)
    assert new.uncertainty is not None
    assert set(new.uncertainty.resin or ()) == {"absorption_per_mm", "critical_exposure_mj_per_cm2"}
    assert new.calibration is not None
    assert new.calibration["resin"].sha256 == sha256_of(depths)
    assert json.loads((tmp_path / "new.json").read_text()) == result
    assert result["found"][1]["before"] == 0.07
    assert "[resin] critical_exposure_mj_per_cm2" in (tmp_path / "new.html").read_text()


def test_the_rig_that_is_read_is_not_overwritten(rig: Path, depths: Path) -> None:
    with pytest.raises(InputError, match="the rig that is read"):
        calibrate_resin(depths, rig, rig)
    assert rig.read_text() == RIG


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("exposure_mj_per_cm2,depth\n50,3", "no column depth_mm"),
        ("exposure_mj_per_cm2,depth_mm\n50,deep", "line 2: depth_mm is 'deep'"),
        ("exposure_mj_per_cm2,depth_mm\n50,\n", "line 2: depth_mm is ''"),
        ("exposure_mj_per_cm2,depth_mm\n50,3\n0,1\n70,4", "exposure_mj_per_cm2 is 0"),
        ("", "no column"),
    ],
)
def test_a_table_that_cannot_be_used_is_told(rig: Path, tmp_path: Path, text: str, told: str) -> None:
    (tmp_path / "bad.csv").write_text(text)
    with pytest.raises(InputError, match=told):
        calibrate_resin(tmp_path / "bad.csv", rig, tmp_path / "new.toml")
    assert not list(tmp_path.glob("new.*"))


def test_a_preset_may_be_named_as_for_other_commands(depths: Path, tmp_path: Path) -> None:
    new = tmp_path / "new.toml"
    told = CliRunner().invoke(
        main, ["calibrate", "resin", str(depths), "--rig", "orth2022-190", "--out", str(new), "--json"]
    )
    assert told.exit_code == 0, told.output
    rig = load_rig(new)
    assert rig.resin.critical_exposure_mj_per_cm2 == pytest.approx(30.0, rel=1e-4)
    assert rig.need_camera().pixel_mm == find_rig("orth2022-190").need_camera().pixel_mm


def test_a_rig_that_is_not_there_is_told(depths: Path, tmp_path: Path) -> None:
    told = CliRunner().invoke(
        main, ["calibrate", "resin", str(depths), "--rig", "orth2023", "--out", str(tmp_path / "new.toml")]
    )
    assert told.exit_code == 2
    assert "orth2023" in told.stderr
