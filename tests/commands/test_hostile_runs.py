"""A run's folder from anywhere: what is wrong in it is told in one line, and nothing outside it is read."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from hostile import refused
from vialight.cli import main
from vialight.commands.calibrate import check_calibration
from vialight.commands.kinetics import kinetics_of
from vialight.commands.measure import measure_surface
from vialight.control.looking_back import Place
from vialight.control.stop_model import StopModel
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology.kinetics.shown_light import light_of, patterns_shown
from vialight.printing.live.lit_time import LitTime
from vialight.store import open_frames, write_frames, write_json, write_stl

CORNER = Mesh(
    np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
)
PNG = b"\x89PNG\r\n\x1a\n"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "gift"
    folder.mkdir()
    write_frames(folder / "frames.h5", np.ones((4, 2, 3), np.uint16), np.arange(4.0), time_s=np.arange(4.0))
    (folder / "rig.toml").write_text("[resin]\nthreshold = 1.0\n")
    write_stl(folder / "surface.stl", CORNER)
    write_stl(folder / "reference.stl", CORNER)
    return folder


def look(run: Path) -> None:
    kinetics_of(run, Place((0.0, 0.0, 0.0)))


def light(run: Path) -> None:
    with open_frames(run / "frames.h5") as frames:
        light_of(run, Rig(), frames, None)


def measure(run: Path) -> None:
    measure_surface(run, run / "reference.stl", run.parent / "out")


@pytest.mark.parametrize("name", ["rig.toml", "frames.h5", "plan.h5", "reference.stl", "rehearsal.json"])
def test_kinetics_reads_nothing_that_leads_out_of_a_run(run: Path, tmp_path: Path, name: str) -> None:
    (tmp_path / "private").write_text("mine")
    (run / name).unlink(missing_ok=True)
    (run / name).symlink_to(tmp_path / "private")
    assert "leads out of its folder" in refused(look, run)


@pytest.mark.parametrize("name", ["rig.toml", "frames.h5"])
@pytest.mark.parametrize("command", ["reconstruct", "calibrate check"])
def test_no_command_that_takes_a_run_reads_what_leads_out_of_it(
    run: Path, tmp_path: Path, command: str, name: str
) -> None:
    (run / name).rename(tmp_path / "private")
    (run / name).symlink_to(tmp_path / "private")
    told = CliRunner().invoke(main, [*command.split(), str(run)])
    assert told.exit_code == 2
    assert "leads out of its folder" in told.stderr


def test_a_page_about_a_run_is_not_written_elsewhere(run: Path, tmp_path: Path) -> None:
    (tmp_path / "private.html").write_text("mine")
    (run / "check.html").symlink_to(tmp_path / "private.html")
    with pytest.raises(InputError, match="leads out of its folder"):
        check_calibration(run)


def test_kinetics_writes_nothing_that_leads_out_of_a_run(run: Path, tmp_path: Path) -> None:
    (tmp_path / "private").mkdir()
    (run / "kinetics").symlink_to(tmp_path / "private")
    assert "kinetics: leads out of its folder" in refused(look, run)


@pytest.mark.parametrize("name", ["plan", "reference"])
def test_kinetics_asks_for_nothing_of_a_run_that_is_given_from_elsewhere(run: Path, tmp_path: Path, name: str) -> None:
    there = run / {"plan": "plan.h5", "reference": "reference.stl"}[name]
    there.unlink(missing_ok=True)
    there.symlink_to(tmp_path / "private")
    given: dict[str, Any] = {name: tmp_path / "absent"}
    with pytest.raises(InputError, match="absent"):
        kinetics_of(run, Place((0.0, 0.0, 0.0)), **given)


@pytest.mark.parametrize("name", ["rig.toml", "frames.h5", "plan.h5", "reference.stl", "rehearsal.json"])
def test_kinetics_waits_for_no_pipe(run: Path, name: str) -> None:
    (run / name).unlink(missing_ok=True)
    os.mkfifo(run / name)
    assert "is a pipe" in refused(look, run)


@pytest.mark.parametrize(
    "log",
    [
        "refresh_s,shown_s,due\n1,1,1\n",
        "refresh_s,shown_s,due,shown\n1,now,1,1\n",
        "refresh_s,shown_s,due,shown\n1,nan,1,1\n",
        "refresh_s,shown_s,due,shown\n1,1e300,1,1\n2,0,1,1\n",
        "refresh_s,shown_s,due,shown\n1,1,1," + "9" * 5000 + "\n",
        "refresh_s,shown_s,due,shown\n1\n",
        "\xff\xfe\n",
    ],
    ids=range(7),
)
def test_a_log_that_no_projector_writes_is_refused(run: Path, log: str) -> None:
    (run / "projector.csv").write_text(log, encoding="latin-1")
    assert "projector.csv" in refused(light, run)


@pytest.mark.parametrize("printed", [{"lit_s": "long"}, {"lit_s": 1e300}, {"lit_s": -1.0}, {"lit_s": [1]}])
def test_a_lit_time_that_is_none_is_refused(run: Path, printed: Any) -> None:
    write_json(run / "run.json", {"printed": printed})
    assert "printed.lit_s" in refused(light, run)


@pytest.mark.parametrize("printed", [[], "text", 3, None, {}])
def test_a_run_that_does_not_say_how_long_it_was_lit_counts_as_always_lit(run: Path, printed: Any) -> None:
    write_json(run / "run.json", {"printed": printed})
    with open_frames(run / "frames.h5") as frames:
        assert light_of(run, Rig(), frames, None).source == "recorded, light on from the first frame"


def test_a_recording_of_ages_is_refused_before_its_patterns_are_listed(run: Path) -> None:
    write_frames(run / "frames.h5", np.ones((2, 2, 3), np.uint16), np.arange(2.0), time_s=[0.0, 5e9])
    assert "those of a print" in refused(light, run)


def test_the_light_of_a_run_is_not_looked_for_elsewhere(run: Path, tmp_path: Path) -> None:
    (tmp_path / "private").write_text("refresh_s,shown_s,due,shown\n1.0,1.0,7,7\n")
    (run / "projector.csv").symlink_to(tmp_path / "private")
    for read in (light, patterns_shown, lambda folder: LitTime(folder / "projector.csv").at(1.0)):
        with pytest.raises(InputError, match="leads out of its folder"):
            read(run)
    (run / "projector.csv").unlink()
    os.mkfifo(run / "projector.csv")
    for read in (light, patterns_shown, lambda folder: LitTime(folder / "projector.csv").at(1.0)):
        with pytest.raises(InputError, match="is a pipe"):
            read(run)


def test_lines_of_a_log_that_are_none_change_no_lit_time(tmp_path: Path) -> None:
    log = tmp_path / "projector.csv"
    log.write_bytes(b"refresh_s,shown_s,due,shown\n1,1.0,7,7\n\xff\n1,nan,7,-1\n1,2\n2,x,1,1\n3,3.0,-1,-1\n4,")
    lit = LitTime(log)
    assert lit.at(9.0) == 2.0
    with log.open("a") as file:
        file.write("5.0,1,1\n")
    assert lit.at(9.0) == 6.0


@pytest.mark.parametrize(
    ("pictures", "told"),
    [
        ([{"file": "../private.png", "title": "a", "caption": "b"}], "leads out of its folder"),
        ([{"file": "/etc/hostname", "title": "a", "caption": "b"}], "leads out of its folder"),
        ([{"file": "pictures/link.png", "title": "a", "caption": "b"}], "leads out of its folder"),
        ([{"file": "rig.toml", "title": "a", "caption": "b"}], "is no PNG"),
        ([{"file": "pipe.png", "title": "a", "caption": "b"}], "is a pipe"),
        ([{"file": "absent.png", "title": "a", "caption": "b"}], "No such file"),
        ([{"file": "rig.toml"}] * 1000, "no list of a few"),
        ([3], "cannot be used"),
        ({"a": 1}, "no list of a few"),
    ],
    ids=range(9),
)
def test_pictures_of_a_report_come_from_the_reconstruction_alone(
    run: Path, tmp_path: Path, pictures: Any, told: str
) -> None:
    (tmp_path / "private.png").write_bytes(PNG)
    (run / "pictures").mkdir()
    (run / "pictures" / "link.png").symlink_to(tmp_path / "private.png")
    os.mkfifo(run / "pipe.png")
    write_json(run / "reconstruction.json", {"pictures": pictures})
    with pytest.raises(InputError, match=told):
        measure(run)


def test_a_surface_that_leads_out_of_a_reconstruction_is_not_measured(run: Path, tmp_path: Path) -> None:
    (run / "surface.stl").rename(tmp_path / "private.stl")
    (run / "surface.stl").symlink_to(tmp_path / "private.stl")
    with pytest.raises(InputError, match="leads out of its folder"):
        measure(run)


MODEL: dict[str, Any] = {
    "points_mm": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]],
    "size_mm": 0.2,
    "sensitivities": [0.8, 1.0],
    "crossing_s": [[1.0, None], [2.0, 3.0]],
    "stop_s": [10.0, 12.0],
    "turn_s": 18.0,
    "waiting_s": [0.0, 1.0],
    "doubts": [{"name": "oxygen", "crossing_change": [0.1, None], "stop_change": 0.1}],
}


@pytest.mark.parametrize(
    "change",
    [
        {"doubts": [3]},
        {"doubts": 3},
        {"doubts": {"a": 1}},
        {"turn_s": 0.0},
        {"turn_s": "long"},
        {"waiting_s": []},
        {"waiting_s": [[1.0]]},
        {"points_mm": [[None, 0, 0], [0, 0, 0]]},
        {"points_mm": [[1e300, 0, 0], [0, 0, 0]]},
        {"size_mm": -1},
        {"gel_share": 0},
        {"crossing_s": [[1.0], [2.0, 3.0]]},
        {"stop_s": ["a", "b"]},
        {"doubts": [{"name": "x", "crossing_change": [0.1], "stop_change": 0.1}]},
    ],
    ids=range(14),
)
def test_a_rehearsal_that_says_nothing_is_refused(change: dict[str, Any]) -> None:
    assert StopModel.from_json(MODEL).turn_s == 18
    with pytest.raises(InputError, match="stop model"):
        StopModel.from_json(MODEL | change)
