"""The demo, as a newcomer runs it, in a resin that is not as believed; and what can be asked of its run afterwards."""

from __future__ import annotations

import csv
import json
from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from vialight.cli import main
from vialight.commands import demo
from vialight.control.rehearsal import Rehearser
from vialight.control.rehearsed_model import camera_resolution_mm
from vialight.store import list_history, read_plan, read_series
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.twin import load_resin

pytestmark = pytest.mark.alone

SENSITIVITY = 0.8
"""Of the resin in the vial, relative to what the rig says it is."""


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    folder = tmp_path_factory.mktemp("demo")
    preset = (files("vialight") / "twin" / "presets" / "resins" / "DUDMA.toml").read_text(encoding="utf-8")
    (folder / "lot.toml").write_text(preset.replace("[chemistry]", f"[chemistry]\nsensitivity = {SENSITIVITY} #"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(demo, "_SIMULATION", replace(demo._SIMULATION, resin=str(folder / "lot.toml")))
        done = CliRunner().invoke(main, ["demo", "--out", str(folder / "demo"), "--json"])
    assert done.exit_code == 0, done.stderr
    return folder / "demo", json.loads(done.stdout)


def test_auto_stops_within_the_promised_band_of_the_best_dose(made: tuple[Path, dict[str, Any]]) -> None:
    out, result = made
    printed = result["printed"]
    assert printed["ended_by"] == "auto"
    plan, rig, resin = read_plan(out / "plan.h5"), load_rig(out / "run" / "rig.toml"), load_resin("DUDMA")
    voxel_mm = demo._LIVE.rehearsal_voxel_mm
    true = Rehearser(plan, rig, resin, voxel_mm, camera_resolution_mm(rig, voxel_mm)).rehearse(resin, SENSITIVITY)
    assert -0.05 < printed["lit_s"] / true.stop_s - 1 < 0.05
    assert abs(printed["forecast"]["stop_s"] - true.stop_s) < 2 * printed["forecast"]["sigma_s"]


def test_the_report_shows_what_came_of_it_and_how_it_grew(made: tuple[Path, dict[str, Any]]) -> None:
    run = made[0] / "run"
    measured = made[1]["measured"]["as_placed"]
    assert measured["rmse_mm"] < 0.25  # the size of its voxels
    assert measured["iou"] > 0.7
    report = (run / "report.html").read_text(encoding="utf-8")
    assert "How the print grew" in report
    assert list_history(run)


def test_volumes_over_time_are_kept_four_times_a_turn_and_grow(made: tuple[Path, dict[str, Any]]) -> None:
    volumes = read_series(made[0] / "run" / "volumes.zarr")
    threshold = load_rig(made[0] / "run" / "rig.toml").need_threshold()
    cured = [float((volumes.volume(k).density > threshold).mean()) for k in (0, len(volumes) - 1)]
    assert cured[0] < 0.01 < 0.05 < cured[1]
    assert (np.diff(volumes.time_s) > 0).all()


def test_kinetics_tell_density_and_dose_inside_and_out(made: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    run = made[0] / "run"
    part = load_mesh(run / "reference.stl")
    inside = (3.0, -2.5, float(part.bounds_mm[0, 2]) + 1.0)  # in the base
    found = {}
    for name, (x, y, z) in {"inside": inside, "outside": (0.0, 6.5, 0.0)}.items():
        done = CliRunner().invoke(
            main,
            [
                "kinetics",
                str(run),
                f"--at={x},{y},{z}",
                "--radius",
                "0.3",
                "--voxel",
                "0.31",
                "--out",
                str(tmp_path / name),
                "--json",
            ],
        )
        assert done.exit_code == 0, done.stderr
        found[name] = json.loads(done.stdout)
        with (tmp_path / name / "kinetics.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        assert [float(row["lit_s"]) for row in rows] == pytest.approx(found[name]["table"]["lit_s"], rel=1e-4)
        assert float(rows[-1]["dose_mj_per_cm2"]) > 0
        assert {item.name for item in (tmp_path / name).iterdir()} == {
            "kinetics.csv", "kinetics.json", "kinetics.png", "gel_time.png",
        }  # fmt: skip
    assert "projector.csv" in found["inside"]["light"]
    assert found["inside"]["gelled_at_lit_s"] is not None
    assert found["outside"]["gelled_at_lit_s"] is None
    doses = {name: one["table"]["dose"] for name, one in found.items()}
    assert (np.diff(doses["inside"]) >= 0).all()
    assert doses["inside"][-1] > 1.5 * doses["outside"][-1]
    assert found["inside"]["table"]["lit_s"][-1] == pytest.approx(made[1]["printed"]["lit_s"], rel=0.02)
