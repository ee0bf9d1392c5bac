"""Kinetics of runs that lack something: a plan, a log, a reference, an end."""

from __future__ import annotations

import json
import shutil
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from vialight.cli import main
from vialight.metrology.kinetics.shown_light import light_of
from vialight.store import open_frames, write_json
from vialight.store.rig_files import load_rig

SAMPLE = Path(str(files("vialight") / "commands" / "sample"))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    for name in ("frames.h5", "rig.toml"):
        shutil.copyfile(SAMPLE / name, tmp_path / name)
    return tmp_path


def kinetics(run: Path, *options: str) -> dict[str, Any]:
    done = CliRunner().invoke(main, ["kinetics", str(run), "--at", "3.0,-2.5,-3.0", "--json", *options])
    assert done.exit_code == 0, done.stderr
    told: dict[str, Any] = json.loads(done.stdout)
    return told


def test_a_recording_without_plan_has_density_and_no_dose(run: Path) -> None:
    told = kinetics(run)
    assert told["dose_unit"] is None
    assert "dose" not in told["table"]
    assert told["failures"] is None
    assert told["table"]["density_counts_per_mm"][-1] > told["settings"]["threshold_counts_per_mm"]
    assert (run / "kinetics" / "gel_time.png").stat().st_size > 1000


def test_a_part_that_is_elsewhere_than_meant_has_failed_there(run: Path) -> None:
    assert kinetics(run, "--reference", str(SAMPLE / "part.stl"), "--tolerance", "0.4")["failures"] == []
    from vialight.store import write_stl
    from vialight.store.foreign.meshes import load_mesh

    moved = np.eye(4)
    moved[2, 3] = 1.5
    write_stl(run / "reference.stl", load_mesh(SAMPLE / "part.stl").moved(moved))
    failures = kinetics(run, "--tolerance", "0.4")["failures"]
    assert failures[0]["what"] == "gelled outside the tolerance"
    assert failures[0]["at_mm"][2] < -2.0  # what was to be higher hangs out below


def test_a_place_that_is_not_seen_is_refused(run: Path) -> None:
    told = CliRunner().invoke(main, ["kinetics", str(run), "--at", "30,0,0"])
    assert told.exit_code == 2
    assert "lies outside what the camera sees" in told.output
    assert not (run / "kinetics").exists()


def test_light_is_known_from_the_log_even_if_its_last_line_was_cut(run: Path) -> None:
    (run / "projector.csv").write_text(
        "refresh_s,shown_s,due,shown\n1.0,1.0,7,7\n1.1,1.1,8,8\n3.0,3.0,-1,-1\n4.0,4.0,9,9\n5.0,5.0,-1,-1\n6.0,6.0,1"
    )
    with open_frames(run / "frames.h5") as frames:
        light = light_of(run, load_rig(run / "rig.toml"), frames, None)
    assert light.lit_at(np.array([0.5, 2.0, 3.5, 4.5, 9.0])).tolist() == [0.0, 1.0, 2.0, 2.5, 3.0]
    assert light.off_at_lit_s == 3.0
    assert light.turns_at(np.array([7.0]), 2.0).tolist() == [2.5]
    assert light.time_at(2.5) == 4.5


def test_light_is_known_from_how_long_it_was_on(run: Path) -> None:
    write_json(run / "run.json", {"printed": {"lit_s": 5.0}})
    with open_frames(run / "frames.h5") as frames:
        light = light_of(run, load_rig(run / "rig.toml"), frames, None)
    assert light.lit_at(np.array([4.0, 9.0])) == pytest.approx([4.0, 5.0])
    assert "run.json" in light.source
