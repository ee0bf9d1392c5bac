"""Images and video hold the patterns as they are, at the times when they are due."""

from __future__ import annotations

import csv
import dataclasses
import sys
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from PIL import Image

from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.store import export_mp4, export_png

PROJECTOR = {
    "distance_mm": 119.8, "pixel_mm": 0.065, "columns": 63, "rows": 47, "axis_column": 31.0, "azimuth_deg": -90.0,
    "frame_rate_hz": 32.0,
}  # fmt: skip


def plan_of(count: int, *, direction: int = 1, first_angle_rad: float = 0.0) -> Plan:
    rng = np.random.default_rng(2)
    levels = rng.integers(0, 256, (count, 30, 40), dtype=np.uint8)
    levels[:, 0, 0] = np.arange(count)  # which pattern it is
    rig = Rig.model_validate({"projector": PROJECTOR, "stage": {"direction": direction}})
    angles = first_angle_rad + np.arange(count) * 2 * np.pi / count
    part = Mesh(np.eye(3), np.array([[0, 1, 2]]))
    target = np.zeros((2, 4, 4), np.float32)
    return Plan(Patterns(levels, angles, 5, 7, 1.0), part, target, Grid((2, 4, 4), 0.1), rig)


def frames_of(path: Path) -> tuple[np.ndarray, float]:
    with av.open(str(path)) as container:
        rate = container.streams.video[0].average_rate
        assert rate is not None
        # The grey of a frame is its first plane.
        images = [np.array(frame.to_ndarray()[: frame.height]) for frame in container.decode(video=0)]
        return np.stack(images), float(rate)


def shown(frames: np.ndarray) -> list[int]:
    return [int(frame[5, 7]) for frame in frames]


def test_images_are_the_projectors_with_the_pattern_in_its_place(tmp_path: Path) -> None:
    plan = plan_of(12)
    export_png(plan, tmp_path / "images")
    with (tmp_path / "images" / "angles.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["stage_angle_deg"]) for row in rows] == pytest.approx(list(range(0, 360, 30)))
    assert [row["file"] for row in rows] == sorted(row["file"] for row in rows)
    assert rows[1]["file"] == "pattern_0001_030.000deg.png"
    for index, row in enumerate(rows):
        image = np.asarray(Image.open(tmp_path / "images" / row["file"]))
        assert (str(image.dtype), image.shape) == ("uint8", (47, 63))
        np.testing.assert_array_equal(image[5:35, 7:47], plan.patterns.levels[index])
        assert int(image.sum()) == int(plan.patterns.levels[index].sum())


def test_lossless_video_gives_every_level_back(tmp_path: Path) -> None:
    plan = plan_of(36)
    path = tmp_path / "plan.mp4"
    count = export_mp4(plan, path, frame_rate_hz=30, speed_deg_s=300)
    frames, rate = frames_of(path)
    assert (frames.shape, count, rate) == ((36, 48, 64), 36, 30)  # even
    np.testing.assert_array_equal(frames[:, 5:35, 7:47], plan.patterns.levels)
    frames[:, 5:35, 7:47] = 0
    assert not frames.any()


def test_compatible_video_stays_near_the_levels_in_full_range(tmp_path: Path) -> None:
    plan = plan_of(8)
    plan.patterns.levels[:] = np.linspace(0, 255, 40).astype(np.uint8)  # as smooth as patterns are
    path = tmp_path / "plan.mp4"
    export_mp4(plan, path, frame_rate_hz=16, speed_deg_s=720, quality="compatible")
    frames, _ = frames_of(path)
    error = frames[:, 5:35, 7:47].astype(int) - plan.patterns.levels
    assert np.abs(error).max() <= 6
    assert np.abs(error).mean() < 1


def test_each_frame_shows_the_pattern_due_in_its_middle(tmp_path: Path) -> None:
    plan = plan_of(20, first_angle_rad=0.3)
    path = tmp_path / "plan.mp4"
    assert export_mp4(plan, path, frame_rate_hz=25, speed_deg_s=180, turns=1.5) == 75  # 7.2 degrees a frame, of 18
    expected = [round(7.2 * k / 18) % 20 for k in range(75)]
    assert shown(frames_of(path)[0]) == expected


def test_a_clockwise_stage_sees_the_patterns_backwards(tmp_path: Path) -> None:
    export_mp4(plan_of(12, direction=-1), tmp_path / "rig.mp4", frame_rate_hz=12 / 18)  # the rig's 20 deg/s
    expected = [0, *range(11, 0, -1)]
    assert shown(frames_of(tmp_path / "rig.mp4")[0]) == expected
    export_mp4(plan_of(12), tmp_path / "asked.mp4", frame_rate_hz=12, speed_deg_s=-360)
    assert shown(frames_of(tmp_path / "asked.mp4")[0]) == expected


def test_video_is_as_long_as_the_turns_take(tmp_path: Path) -> None:
    assert export_mp4(plan_of(4), tmp_path / "plan.mp4") == 18 * 32
    frames, rate = frames_of(tmp_path / "plan.mp4")
    assert (len(frames), rate) == (576, 32)


def test_without_the_package_it_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(InputError, match=r"needs the package av.*pip install 'vialight\[video\]'"):
        export_mp4(plan_of(4), tmp_path / "plan.mp4")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"speed_deg_s": 0.0}, "speed_deg_s: is 0.0"),
        ({"turns": -1.0}, "turns: is -1.0"),
        ({"frame_rate_hz": float("nan")}, "frame_rate_hz: is nan"),
        ({"turns": 1e9}, "make 576000000000 frames"),
        ({"turns": 1e-9}, "make 0 frames"),
    ],
)
def test_impossible_numbers_are_refused(tmp_path: Path, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        export_mp4(plan_of(4), tmp_path / "plan.mp4", **arguments)
    assert not list(tmp_path.iterdir())


def test_patterns_that_do_not_fit_the_projector_are_refused(tmp_path: Path) -> None:
    plan = plan_of(4)
    wide = dataclasses.replace(plan, patterns=dataclasses.replace(plan.patterns, first_column=30))
    for export in (export_png, export_mp4):
        with pytest.raises(InputError, match="47 rows and 63 columns, the patterns go from row 5, column 30"):
            export(wide, tmp_path / "out")
    assert not list(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"no table \[projector\]"):
        export_png(dataclasses.replace(plan, rig=Rig()), tmp_path / "out")
