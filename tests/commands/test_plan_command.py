"""A part becomes a plan, end to end on coarse voxels; what cannot become one is refused before anything is written."""

from __future__ import annotations

import json
from dataclasses import asdict, replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vialight.commands.plan import exposure_json, plan_part, score_plan
from vialight.commands.plan_settings import PlanSettings
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns
from vialight.planning.scoring import judged_voxels, score_dose
from vialight.planning.shapes import thin_wall_box
from vialight.store import read_plan, write_stl
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.twin.exposure import dose_of

PRINTER = (files("vialight") / "commands" / "sample" / "printer.toml").read_text(encoding="utf-8")
for _whole, _part in (("columns = 1024", "columns = 420"), ("rows = 768", "rows = 160"), ("511.5", "209.5")):
    PRINTER = PRINTER.replace(_whole, _part)  # no more of the image than is used, to be quick
COARSE = PlanSettings(angles=60, voxel_mm=0.4, passes=6)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    path = tmp_path / "rig.toml"
    path.write_text(PRINTER, encoding="utf-8")
    return path


@pytest.fixture
def part(tmp_path: Path) -> Path:
    path = tmp_path / "cup.stl"
    write_stl(path, thin_wall_box((7.0, 6.0, 5.0), 1.2))
    return path


def written(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def plan_in(folder: Path, part: Path, rig: Path, **how: Any) -> dict[str, Any]:
    folder.mkdir(exist_ok=True)
    usual: dict[str, Any] = {"settings": COARSE, "page": False}
    return plan_part(part, rig, folder / "plan.h5", **(usual | how))


def test_a_part_becomes_a_plan_that_prints_it_by_traced_light(part: Path, rig: Path, tmp_path: Path) -> None:
    """A cup of 1.2 mm walls in 0.4 mm voxels: judged from its file, by the twin, it comes out whole."""
    result = plan_in(tmp_path / "out", part, rig, page=True)
    assert written(tmp_path / "out") == ["plan.h5", "plan.html", "plan.json"]
    plan = read_plan(tmp_path / "out" / "plan.h5")
    assert json.loads((tmp_path / "out" / "plan.json").read_text(encoding="utf-8")) == json.loads(json.dumps(result))
    assert plan.patterns.levels.shape == tuple(result["patterns"]["shape"])
    assert len(plan.patterns.levels) == 60
    assert plan.patterns.levels.max() == 255
    assert plan.rig.model_dump() == load_rig(rig).model_dump()
    assert plan.settings["angles"] == 60
    assert set(plan.inputs) == {"part", "rig"}
    np.testing.assert_allclose(plan.reference.extents_mm, [7, 6, 5], atol=1e-5)
    np.testing.assert_allclose(plan.reference.bounds_mm.mean(axis=0), 0, atol=1e-5)
    assert result["metrics"]["jaccard"] > 0.98
    assert result["metrics"]["passes"] == 6
    traced = dose_of(plan.patterns, plan.rig, plan.grid, angles_a_pattern=2, points_a_voxel=(2, 2, 2))
    score = score_dose(traced, plan.target, judged_voxels(plan.grid))
    assert score.jaccard > 0.98
    assert score.in_part_mean == pytest.approx(1, abs=0.04)


def test_walls_are_more_even_when_patterns_are_planned_as_held(rig: Path, tmp_path: Path) -> None:
    """Traced by the twin at six stage angles for each pattern of 10 degrees: a range of 0.21 instead of 0.30."""
    wall = tmp_path / "wall.stl"
    write_stl(wall, thin_wall_box((10.0, 8.0, 5.0), 0.8))
    ranges = []
    for held in (1, 2):
        plan_in(tmp_path / "out", wall, rig, settings=replace(COARSE, angles=36, passes=20, held=held))
        plan = read_plan(tmp_path / "out" / "plan.h5")
        traced = dose_of(plan.patterns, plan.rig, plan.grid, angles_a_pattern=6, points_a_voxel=(1, 2, 2))
        ranges.append(score_dose(traced, plan.target, judged_voxels(plan.grid)).in_part_dose_range)
    assert ranges[1] < 0.8 * ranges[0]


@pytest.mark.parametrize("method", ["object-space", "osmo", "normalised", "gradient"])
def test_a_resumed_run_equals_one_that_ran_through(method: Any, part: Path, rig: Path, tmp_path: Path) -> None:
    settings = replace(COARSE, method=method, angles=24, passes=4 if method != "gradient" else 2)
    plan_in(tmp_path / "through", part, rig, settings=settings)
    first = replace(settings, passes=settings.passes // 2 if settings.passes else None)
    plan_in(tmp_path / "first", part, rig, settings=first, save_state=tmp_path / "state.npz")
    plan_in(tmp_path / "rest", part, rig, settings=settings, resume=tmp_path / "state.npz")
    through, rest = (read_plan(tmp_path / name / "plan.h5") for name in ("through", "rest"))
    np.testing.assert_array_equal(rest.patterns.levels, through.patterns.levels)
    assert rest.metrics["passes"] == through.metrics["passes"]


def test_a_run_that_is_stopped_writes_the_best_so_far(part: Path, rig: Path, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    result = plan_in(
        tmp_path / "stopped", part, rig, settings=replace(COARSE, passes=500),
        progress=lambda *at: told.append(at), keep_going=lambda: len(told) < 3,
    )  # fmt: skip
    assert told == [(1, 500), (2, 500), (3, 500)]
    assert result["metrics"]["passes"] <= 3
    plan_in(tmp_path / "short", part, rig, settings=replace(COARSE, passes=3))
    stopped, short = (read_plan(tmp_path / name / "plan.h5") for name in ("stopped", "short"))
    np.testing.assert_array_equal(stopped.patterns.levels, short.patterns.levels)


def test_a_plan_is_scored_anew_under_another_rig(part: Path, rig: Path, tmp_path: Path) -> None:
    """Under its own rig as planned; with absorption doubled, the same patterns bring less and less evenly."""
    # Passes enough that what is uneven is the absorption's doing.
    result = plan_in(tmp_path / "out", part, rig, settings=replace(COARSE, passes=20))
    same = score_plan(tmp_path / "out" / "plan.h5", rig)
    assert same["metrics"].keys() <= same["metrics_as_planned"].keys()
    for name, value in same["metrics"].items():
        assert value == pytest.approx(result["metrics"][name], rel=1e-4), name
    other = tmp_path / "other.toml"
    other.write_text(PRINTER.replace("absorption_per_mm = 0.08", "absorption_per_mm = 0.16"), encoding="utf-8")
    changed = score_plan(tmp_path / "out" / "plan.h5", other)
    # The vial's inner radius is 11.3 mm: exp(-0.08 * 11.3) of it is left near the axis.
    assert changed["metrics"]["in_part_mean"] == pytest.approx(
        np.exp(-0.08 * 11.3) * result["metrics"]["in_part_mean"], rel=0.1
    )
    assert changed["metrics"]["in_part_dose_range"] > result["metrics"]["in_part_dose_range"]
    assert changed["metrics_as_planned"] == same["metrics_as_planned"]


def test_exposure_is_irradiance_times_time(rig: Path) -> None:
    """60 mW / cm^2 at 20 deg / s is 1080 mJ / cm^2 a turn at full level; the threshold is what share of that it is."""
    patterns = Patterns(np.full((8, 2, 2), 255, np.uint8), np.arange(8) * np.pi / 4, 0, 0, 1 / (2 * np.pi * 255))
    score = score_dose(
        np.array([[[0.8, 0.1]]], np.float32), np.array([[[1, 0]]], np.float32), np.ones((1, 1, 1), bool), patterns
    )
    found = exposure_json(score, patterns, load_rig(rig))
    assert found["exposure_per_turn_mj_per_cm2"] == pytest.approx(0.8 * 60 * 18)
    assert found["turns_to_critical_exposure"] == pytest.approx(962 / (0.8 * 60 * 18))


def broken(change: str, path: Path) -> Path:
    """Write a part with one fault."""
    cup = thin_wall_box((7.0, 6.0, 5.0), 1.2)
    vertices, faces = np.array(cup.vertices_mm), np.array(cup.faces)
    if change == "hole":
        faces = faces[:-1]
    elif change == "inside out":
        faces = faces[:, ::-1]
    elif change == "twice":
        vertices = np.concatenate([vertices, vertices + 1.1])
        faces = np.concatenate([faces, faces + len(cup.vertices_mm)])
    else:
        vertices = vertices * {"large": 3.0, "metres": 1e-3, "inches": 1 / 25.4}[change]
    write_stl(path, Mesh(vertices, faces))
    return path


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ("hole", "not watertight"), ("inside out", "inside out"), ("twice", "cuts through itself"),
        ("large", "--scale 0\\.\\d+ is the largest that fits"), ("metres", "--scale 1000"), ("inches", "--scale 25.4"),
    ],
)  # fmt: skip
def test_a_part_that_cannot_be_printed_is_refused_in_one_line(
    change: str, words: str, rig: Path, tmp_path: Path
) -> None:
    part = broken(change, tmp_path / "part.stl")
    refused(part, rig, tmp_path, words)


@pytest.mark.parametrize(("text", "words"), [("", "part"), ("solid x\nendsolid x\n", "part")])
def test_a_file_without_a_part_is_refused_in_one_line(text: str, words: str, rig: Path, tmp_path: Path) -> None:
    part = tmp_path / "part.stl"
    part.write_text(text, encoding="utf-8")
    refused(part, rig, tmp_path, words)


def test_a_part_that_is_not_a_number_is_refused_in_one_line(part: Path, rig: Path, tmp_path: Path) -> None:
    mesh = load_mesh(part)
    lines = [f"v {x} {y} {z}" for x, y, z in mesh.vertices_mm]
    lines[3] = "v nan 0 0"
    obj = tmp_path / "part.obj"
    obj.write_text("\n".join(lines + [f"f {a + 1} {b + 1} {c + 1}" for a, b, c in mesh.faces]), encoding="utf-8")
    refused(obj, rig, tmp_path, "part.obj")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[projector]", "#", "no table \\[projector\\]|unknown key|is "),
        ("index_writing = 1.49\n", "", "no index_writing"),
        ("[vial]\nouter_radius_mm = 12.4\nwall_mm = 1.1\nwall_index = 1.472\n", "", "no table \\[vial\\]"),
    ],
)
def test_a_rig_that_cannot_print_is_refused_in_one_line(
    old: str, new: str, words: str, part: Path, tmp_path: Path
) -> None:
    text = PRINTER.replace(old, new)
    if old == "[projector]":
        text = PRINTER[: PRINTER.index("[projector]")]
        words = "no table \\[projector\\]"
    rig = tmp_path / "rig.toml"
    rig.write_text(text, encoding="utf-8")
    refused(part, rig, tmp_path, words)


def test_a_state_of_another_grid_is_refused_in_one_line(part: Path, rig: Path, tmp_path: Path) -> None:
    plan_in(tmp_path / "first", part, rig, settings=replace(COARSE, passes=1), save_state=tmp_path / "state.npz")
    refused(part, rig, tmp_path, "state.npz", settings=replace(COARSE, angles=36), resume=tmp_path / "state.npz")
    (tmp_path / "state.npz").write_bytes(b"no state")
    refused(part, rig, tmp_path, "damaged", resume=tmp_path / "state.npz")


@pytest.mark.parametrize("voxel_mm", [0.0, -0.1, float("nan"), 1e-5, 5.0])
def test_a_voxel_that_makes_no_sense_is_refused_in_one_line(
    voxel_mm: float, part: Path, rig: Path, tmp_path: Path
) -> None:
    refused(part, rig, tmp_path, "voxel", settings=replace(COARSE, voxel_mm=voxel_mm))


def refused(part: Path, rig: Path, folder: Path, words: str, **how: Any) -> None:
    """See that one line is all that comes of it."""
    before = written(folder)
    with pytest.raises(InputError, match=words) as told:
        plan_part(part, rig, folder / "plan.h5", **({"settings": COARSE} | how))
    assert "\n" not in str(told.value)
    assert written(folder) == before


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"angles": 35}, "--angles"), ({"angles": 2}, "--angles"), ({"passes": 0}, "--passes"),
        ({"void_limit": 1.0}, "--void-limit"), ({"ceiling": 0.0}, "--ceiling"), ({"diffusion_mm": -0.1}, "--diffusion"),
        ({"projector_blur_mm": float("nan")}, "--projector-blur"), ({"held": 0}, "--held"),
    ],
)  # fmt: skip
def test_settings_that_make_no_sense_are_refused(wrong: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        PlanSettings(**wrong)


def test_what_is_asked_for_stands_in_the_plan(part: Path, rig: Path, tmp_path: Path) -> None:
    asked = replace(COARSE, passes=1, angles=24, rotate_deg=(90.0, 0.0, 0.0), scale=0.5, coverage=True, climbing=True)
    result = plan_in(tmp_path / "out", part, rig, settings=asked)
    kept = {name: list(value) if isinstance(value, tuple) else value for name, value in asdict(asked).items()}
    found = json.loads(json.dumps(result["settings"]))
    assert {name: found[name] for name in kept} == kept
    plan = read_plan(tmp_path / "out" / "plan.h5")
    np.testing.assert_allclose(plan.reference.extents_mm, [3.5, 2.5, 3.0], atol=1e-5)
    volume = load_mesh(part).volume_mm3 / 8
    assert plan.target.sum() * plan.grid.voxel_mm**3 == pytest.approx(volume, rel=0.03)  # 4 x 4 columns a voxel
