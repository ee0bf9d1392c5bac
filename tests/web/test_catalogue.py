from __future__ import annotations

import json
import os
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest

from vialight.core.config import Rig
from vialight.report.colours import _STOPS
from vialight.web.app import static_files
from vialight.web.catalogue import Catalogue, camera_overlay, overview
from vialight.web.run_log import log_lines
from vialight.web.tokens import token_for


def make_run(folder: Path, **facts: object) -> Path:
    folder.mkdir()
    (folder / "run.json").write_text(json.dumps(facts))
    return folder


def test_runs_are_found_newest_first_and_strangers_are_not(tmp_path: Path) -> None:
    for age, name in enumerate(("first", "second", "third")):
        os.utime(make_run(tmp_path / name) / "run.json", (0, 1000 + age))
    (tmp_path / "notes").mkdir()
    make_run(tmp_path / ".hidden")
    assert [run.name for run in Catalogue(tmp_path).refresh()] == ["third", "second", "first"]
    assert Catalogue(tmp_path / "first").is_single


def test_a_run_is_named_by_keys_of_ours_only(tmp_path: Path) -> None:
    make_run(tmp_path / "run")
    catalogue = Catalogue(tmp_path)
    (run,) = catalogue.refresh()
    assert run.key.isalnum()
    assert catalogue.get(run.key) == run
    for other in ("run", "..", "", "/etc", str(tmp_path / "run")):
        assert catalogue.get(other) is None


@pytest.mark.parametrize("text", ["", "[]", "{", '{"inputs": 3, "state": [], "printed": 7, "name": {}}'])
def test_a_run_whose_facts_are_damaged_is_listed_all_the_same(tmp_path: Path, text: str) -> None:
    make_run(tmp_path / "run")
    (tmp_path / "run" / "run.json").write_text(text)
    (run,) = Catalogue(tmp_path).refresh()
    assert overview(run)["name"] == "run"


def test_a_log_is_told_from_any_event_on_without_the_line_being_written(tmp_path: Path) -> None:
    make_run(tmp_path / "run")
    (run,) = Catalogue(tmp_path).refresh()
    assert log_lines(run, 0) == []
    (run.folder / "log.jsonl").write_text('{"event": "a"}\nnot json\n{"event": "c"}\n{"eve')
    assert [event["event"] for event in log_lines(run, 0)] == ["a", "a line that cannot be read", "c"]
    assert log_lines(run, 2) == [{"event": "c"}]


def test_without_a_vial_the_camera_shows_an_axis_and_no_edges() -> None:
    rig = Rig.model_validate(
        {"geometry": "parallel", "camera": {"pixel_mm": 0.1, "axis_column": 9.5, "optical_row": 4}}
    )
    overlay = camera_overlay(rig)
    assert overlay is not None
    assert (overlay["axis_column"], overlay["edge_columns"]) == (9.5, None)


def test_tokens_differ_by_folder_stay_and_are_only_the_owners(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    first = token_for(tmp_path / "a")
    assert token_for(tmp_path / "a") == first != token_for(tmp_path / "b")
    kept = [path for path in (tmp_path / "state").rglob("*") if path.is_file()]
    assert {path.stat().st_mode & 0o777 for path in kept} == {0o600}
    for path in kept:
        path.chmod(0o644)  # others may have read it
    assert token_for(tmp_path / "a") != first


def test_a_token_is_there_where_nothing_can_be_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    assert len(token_for(tmp_path)) == 43


def test_the_pages_colours_are_the_reports_and_cividis() -> None:
    script = static_files()["/static/js/colours.js"][0].decode()
    stops = script.split("const DEVIATION = ")[1].split(";")[0]
    assert np.array_equal(json.loads(stops), _STOPS)
    text = "".join(script.split("const CIVIDIS = (")[1].split(")")[0].replace('"', "").replace("+", "").split())
    found = np.array([list(bytes.fromhex(text[at : at + 6])) for at in range(0, len(text), 6)])
    wanted = np.rint(255 * mpl.colormaps["cividis"](np.linspace(0, 1, len(found)))[:, :3])
    assert np.array_equal(found, wanted)


def test_only_the_pages_own_files_can_be_asked_for() -> None:
    assert {path.rsplit(".", 1)[-1] for path in static_files() if path != "/"} == {"js", "css", "svg", "ico"}
    assert "/static/vendor/three.module.min.js" in static_files()
