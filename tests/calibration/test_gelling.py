"""The critical exposure from twin's prints: by their true gel times, and by those seen in the frames."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from printing.prints import BINNING, quick_rig, write_quick_plan
from vialight.calibration.resin.gelling import gel_doses
from vialight.cli import main
from vialight.commands.calibrate import calibrate_resin
from vialight.commands.simulate import simulate_print
from vialight.core.errors import InputError
from vialight.store import read_json, rig_to_toml
from vialight.store.rig_files import changed_rig, load_rig
from vialight.twin import TwinSettings, load_resin

IRRADIANCES = {"slow": (60.0, 15.0), "fast": (120.0, 8.0)}
"""mW/cm^2, and turns of light."""


def print_runs(folder: Path) -> None:
    """Print one plan twice, in coarse voxels."""
    plan, rig = write_quick_plan(folder)
    resin = load_resin("DUDMA")
    threshold = {"resin": {"threshold": resin.gel_density * BINNING**2}}
    for name, (irradiance, turns) in IRRADIANCES.items():
        dimmed = changed_rig(quick_rig(), {"projector": {"irradiance_mw_per_cm2": irradiance}}, "test")
        rig.write_text(rig_to_toml(dimmed))
        settings = TwinSettings(binning=BINNING, chemistry_step_s=0.5)
        simulate_print(plan, rig, "DUDMA", folder / name, turns=turns, voxel_mm=0.4, settings=settings)
        believed = changed_rig(load_rig(folder / name / "rig.toml"), threshold, "test")
        (folder / name / "rig.toml").write_text(rig_to_toml(believed))
        shutil.copyfile(plan, folder / name / "plan.h5")


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder: Path = tmp_path_factory.mktemp("gelling")
    print_runs(folder)
    return folder


def test_gel_times_seen_at_two_irradiances_tell_the_dose_at_which_resin_gels_and_how_much_later(
    runs: Path, tmp_path: Path
) -> None:
    """Radicals live for 1 / 0.15 s after their light: alone, even the slower print says 18 % too much."""
    true = read_json(runs / "slow" / "run.json")["truth"]["critical_dose_mj_per_cm2"]
    for name in ("slow", "fast"):
        shutil.copytree(runs / name, tmp_path / name, ignore=shutil.ignore_patterns("gel_time.zarr"))
    told = CliRunner().invoke(
        main,
        ["calibrate", "resin", "--run", str(tmp_path / "slow"), "--run", str(tmp_path / "fast"), "--voxel", "0.6",
         "--rig", str(runs / "slow" / "rig.toml"), "--out", str(tmp_path / "new.toml"), "--json"],
    )  # fmt: skip
    assert told.exit_code == 0, told.stderr
    result = json.loads(told.stdout)
    found, details = result["found"][0], result["details"]
    assert found["key"] == "critical_exposure_mj_per_cm2"
    assert abs(found["value"] - true) < min(2 * found["uncertainty"], 0.1 * true)
    assert 2.0 < details["gels_later_by_s"] < 1 / 0.15
    assert load_rig(tmp_path / "new.toml").resin.critical_exposure_mj_per_cm2 == pytest.approx(true, rel=0.1)
    assert (tmp_path / "new.html").read_text().count("data:image/png") == 2
    by_truth = gel_doses(runs / "slow").critical_mj_per_cm2
    assert by_truth > 1.1 * true
    # Half a turn of 3 s, of 40 s of light, is what may be left.
    assert details["gel_doses_mj_per_cm2"][0] == pytest.approx(by_truth, rel=1.5 / 40)


def test_runs_that_tell_nothing_are_refused(runs: Path, tmp_path: Path) -> None:
    new, run = tmp_path / "new.toml", runs / "slow"
    with pytest.raises(InputError, match="the plan that was printed"):
        calibrate_resin(None, run / "rig.toml", new, runs=[run], plan_path=tmp_path / "no.h5")
    with pytest.raises(InputError, match="a table of depths too"):
        calibrate_resin(tmp_path / "depths.csv", run / "rig.toml", new, runs=[run])
    dark = tmp_path / "dark"
    shutil.copytree(run, dark)
    (dark / "projector.csv").write_text("refresh_s,shown_s,due,shown\n1.0,1.0,1,1\n1.1,1.1,-1,-1\n")
    with pytest.raises(InputError, match="0 voxels within the print gelled while there was light"):
        calibrate_resin(None, run / "rig.toml", new, runs=[dark])
    assert not new.exists()
