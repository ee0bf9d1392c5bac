"""Plans come back as they were written, and nothing else is taken for one."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.store import read_plan, write_plan
from vialight.store.frames import open_frames

RIG = Rig.model_validate(
    {
        "vial": {"outer_radius_mm": 12.4, "wall_mm": 1.1, "wall_index": 1.472},
        "resin": {"name": 'the "new" \\ one', "index_writing": 1.49, "threshold_conditions": {"binning": 4}},
        "projector": {
            "distance_mm": float("inf"), "pixel_mm": 0.065, "columns": 64, "rows": 48, "axis_column": 31.5,
            "azimuth_deg": -90.0,
        },
        "stage": {"direction": "clockwise"},
    }
)  # fmt: skip


@pytest.fixture
def plan() -> Plan:
    rng = np.random.default_rng(1)
    grid = Grid((20, 12, 12), 0.065, 0.3)
    target = rng.random(grid.shape, dtype=np.float32) * (rng.random(grid.shape) < 0.3)
    levels = rng.integers(0, 256, (36, 30, 40), dtype=np.uint8)
    patterns = Patterns(levels, np.arange(36) * np.pi / 18, 5, 7, 0.1 + 0.2)
    corner = Mesh(rng.normal(size=(4, 3)), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]))
    return Plan(
        patterns, corner, target, grid, RIG,
        settings={"method": "osmo", "iterations": 30, "clip": None, "levels": [0.85, 1.0], "name": "Würfel"},
        metrics={"jaccard": 1 / 3, "dose": {"p05": 0.97}},
        inputs={"part": {"file": "part.stl", "sha256": "0" * 64}},
    )  # fmt: skip


@pytest.fixture
def path(tmp_path: Path, plan: Plan) -> Path:
    path = tmp_path / "plan.h5"
    write_plan(path, plan)
    return path


def test_a_plan_comes_back_exactly(path: Path, plan: Plan) -> None:
    back = read_plan(path)
    np.testing.assert_array_equal(back.patterns.levels, plan.patterns.levels)
    np.testing.assert_allclose(back.patterns.angles_rad, plan.patterns.angles_rad, rtol=3e-16)
    np.testing.assert_array_equal(back.target, plan.target)
    np.testing.assert_array_equal(back.reference.vertices_mm, plan.reference.vertices_mm)
    np.testing.assert_array_equal(back.reference.faces, plan.reference.faces)
    for name in ("first_row", "first_column", "dose_rate_per_level"):
        assert getattr(back.patterns, name) == getattr(plan.patterns, name)
    for name in ("grid", "settings", "metrics", "inputs"):
        assert getattr(back, name) == getattr(plan, name)
    assert back.patterns.levels.dtype == np.uint8
    assert back.target.dtype == np.float32
    assert back.rig.model_dump() == plan.rig.model_dump()


def test_errors_of_a_stored_rig_name_the_file(path: Path) -> None:
    with pytest.raises(InputError, match=re.escape(f"{path} /rig: no table [camera]")):
        read_plan(path).rig.need_camera()


def test_patterns_are_stored_one_a_chunk_and_compressed(path: Path) -> None:
    with h5py.File(path) as file:
        assert file["implements"].asstr()[()] == "vialight-plan"
        assert file["patterns"].chunks == (1, 30, 40)
        assert file["patterns"].attrs["axes"] == "angle:row:column"
        assert file["angles_deg"][9] == pytest.approx(90)
        filters = file["patterns"].id.get_create_plist()
        assert filters.get_filter(0)[0] == 32001  # blosc


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"patterns": Patterns(np.zeros((2, 3), np.uint8), np.zeros(2), 0, 0, 1.0)}, "/patterns: is uint8 of shape"),
        ({"patterns": Patterns(np.zeros((2, 3, 3), np.uint8), np.zeros(3), 0, 0, 1.0)}, "3 angles for 2 patterns"),
        ({"target": np.zeros((3, 3, 3), np.float32)}, "/target: is float32 of shape"),
        ({"target": np.zeros((20, 12, 12), np.float64)}, "/target: is float64"),
    ],
)
def test_arrays_that_do_not_fit_are_not_written(
    tmp_path: Path, plan: Plan, change: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        write_plan(tmp_path / "plan.h5", dataclasses.replace(plan, **change))
    assert not list(tmp_path.iterdir())


def test_a_plan_is_written_whole_or_not_at_all(path: Path, plan: Plan) -> None:
    before = path.read_bytes()
    with pytest.raises(TypeError):
        write_plan(path, dataclasses.replace(plan, settings={"method": object()}))
    assert path.read_bytes() == before
    assert list(path.parent.iterdir()) == [path]


def test_a_folder_that_is_missing_is_named(tmp_path: Path, plan: Plan) -> None:
    with pytest.raises(InputError, match="there is no folder"):
        write_plan(tmp_path / "missing" / "plan.h5", plan)


def _cut_short(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-2000])


def _damage_patterns(path: Path) -> None:
    with h5py.File(path, "r+") as file:
        offset = file["patterns"].id.get_chunk_info(3).byte_offset
    content = bytearray(path.read_bytes())
    content[offset : offset + 40] = b"\xff" * 40
    path.write_bytes(content)


def _edited(name: str, value: object = None) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            del file[name]
            if value is not None:
                file[name] = value

    return edit


@pytest.mark.parametrize(
    ("harm", "message"),
    [
        (Path.unlink, "there is no such file"),
        (lambda path: path.write_text("solid"), "is not HDF5"),
        (lambda path: path.write_bytes(b""), "is not HDF5|damaged or cut off"),
        (_cut_short, "is damaged or cut off"),
        (_damage_patterns, "is damaged or cut off"),
        (_edited("implements"), "does not say of what kind"),
        (_edited("implements", "exchange"), "it implements 'exchange'"),
        (_edited("schema", 2), "is a plan of schema 2; accepted: schema 1"),
        (_edited("patterns"), "is damaged or cut off"),
        (_edited("target", np.zeros(3)), "is damaged or cut off"),
        (_edited("angles_deg", np.zeros(3)), "3 angles for 36 patterns"),
        (_edited("rig", "vial = 3"), "is damaged or cut off"),
        (_edited("settings", "{"), "is damaged or cut off"),
        (_edited("reference/faces", np.full((1, 3), 99)), "is damaged or cut off .*faces name vertices 99"),
    ],
)
def test_what_is_no_plan_is_refused_in_one_line(path: Path, harm: Callable[[Path], None], message: str) -> None:
    harm(path)
    with pytest.raises(InputError, match=message) as refusal:
        read_plan(path)
    assert str(refusal.value).startswith(str(path))
    assert "\n" not in str(refusal.value)


def test_a_folder_is_no_plan(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        read_plan(tmp_path)


def test_a_plan_is_not_taken_for_a_recording(path: Path) -> None:
    with pytest.raises(InputError, match="no dataset /exchange/data"):
        open_frames(path)
