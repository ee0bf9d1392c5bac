"""The scale by a flat target, in pictures drawn by traced rays."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.flat_targets import CAMERA, IN_AIR, IN_VIAL, Target, picture
from vialight.calibration.scale.flat_target_command import FlatTarget
from vialight.calibration.scale.flat_target_points import find_grid
from vialight.commands.calibrate import calibrate_scale_by_target
from vialight.core.arrays import FloatArray
from vialight.core.config import Resin, Rig, Vial
from vialight.core.errors import InputError
from vialight.store import rig_to_toml, write_frames
from vialight.store.rig_files import load_rig

BELIEVED = CAMERA.model_copy(update={"pixel_mm": 0.149, "axis_column": 85.0, "optical_row": 59.5})
RIG = Rig(
    vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472), resin=Resin(index_imaging=1.48), camera=BELIEVED
)
ROCKED_DEG = np.array([-20.0, 0.0, 20.0])
EXACT_STD_MM = 1e-6


def scaled(
    folder: Path, target: Target, *, in_vial: bool = False, turned_deg: FloatArray = ROCKED_DEG[1:2],
    pitch_mm: float = 1.5, kind: Any = None, **settings: Any,
) -> dict[str, Any]:  # fmt: skip
    """Calibrate from pictures of a target, its pitch known exactly."""
    optics = IN_VIAL if in_vial else IN_AIR
    frames = [picture(target, optics, turned_deg=angle, seed=k, **settings) for k, angle in enumerate(turned_deg)]
    write_frames(folder / "frames.h5", np.stack(frames), np.radians(turned_deg))
    (folder / "rig.toml").write_text(rig_to_toml(RIG), encoding="utf-8")
    known = FlatTarget(kind or target.kind, pitch_mm, EXACT_STD_MM, in_vial)
    return calibrate_scale_by_target(folder / "frames.h5", folder / "rig.toml", folder / "new.toml", known)


def found(result: dict[str, Any]) -> dict[str, tuple[float, float]]:
    return {one["key"]: (one["value"], one["uncertainty"]) for one in result["found"]}


def test_points_are_found_to_two_hundredths_of_a_pixel() -> None:
    """In air, in the plane of the axis: there they are seen where they are."""
    target = Target("dots", 1.5)
    seen = find_grid(picture(target, IN_AIR).astype(float), "dots", (9.0, 9.0))
    x = (seen.columns - CAMERA.axis_column) * CAMERA.pixel_mm - target.beside_mm[0]
    z = (CAMERA.optical_row - seen.rows) * CAMERA.pixel_mm - target.beside_mm[1]
    off = np.stack([(x / 1.5 - np.rint(x / 1.5)), (z / 1.5 - np.rint(z / 1.5))]) * 1.5 / CAMERA.pixel_mm
    assert len(seen.rows) == 13 * 11
    assert np.sqrt((off**2).mean()) < 0.02
    assert (np.rint(x / 1.5) - seen.across == np.rint(x / 1.5)[0] - seen.across[0]).all()
    assert (np.rint(z / 1.5) - seen.up == np.rint(z / 1.5)[0] - seen.up[0]).all()


def test_a_rocked_target_in_air_tells_pixel_optical_row_and_axis_wherever_it_is_held(tmp_path: Path) -> None:
    """It leans, and lies 0.8 mm behind the axis, by which a single picture would be 0.4 % off."""
    target = Target("dots", 1.5, depth_mm=0.8, yaw_deg=3.0, pitch_deg=-2.0, roll_deg=2.0)
    result = scaled(tmp_path, target, turned_deg=ROCKED_DEG)
    for key, true, fine in (
        ("pixel_mm", 0.155, 5e-4 * 0.155),
        ("optical_row", 57.2, 0.5),
        ("axis_column", 87.3, 0.05),
    ):
        value, std = found(result)[key]
        assert abs(value - true) < min(3 * std, fine)
    notes = " ".join(result["notes"])
    assert "turned by 3.0 deg about the vertical" in notes
    assert "leans by 2.0 deg" in notes
    assert "0.80 mm behind the axis" in notes
    rig = load_rig(tmp_path / "new.toml")
    assert rig.need_camera().pixel_mm == pytest.approx(0.155, rel=5e-4)
    assert (tmp_path / "new.html").read_text().count("data:image/png") == 1


@pytest.mark.parametrize("kind", ["dots", "chessboard"])
def test_one_picture_through_the_vial_tells_pixel_and_optical_row(kind: Any, tmp_path: Path) -> None:
    """Columns are stretched, rows bow about the optical one; a wrong model of it would be percents off."""
    result = scaled(tmp_path, Target(kind, 1.5, depth_mm=0.1), in_vial=True)
    for key, true, fine in (("pixel_mm", 0.155, 1e-3 * 0.155), ("optical_row", 57.2, 1.0)):
        value, std = found(result)[key]
        assert abs(value - true) < min(3 * std, fine)
    assert "axis_column" not in found(result)


def test_one_picture_in_air_leaves_the_optical_row_alone_and_says_what_is_taken_on_trust(tmp_path: Path) -> None:
    result = scaled(tmp_path, Target("dots", 1.5, depth_mm=0.3))
    assert set(found(result)) == {"pixel_mm"}
    value, std = found(result)["pixel_mm"]
    assert abs(value - 0.155) < 2 * std
    assert std == pytest.approx(0.155 * 0.3 / 190, rel=0.1)
    notes = " ".join(result["notes"])
    assert "optical_row is left alone" in notes
    assert "taken on trust" in notes
    assert "distorts" not in notes


def test_a_lens_that_distorts_is_measured_and_warned_of(tmp_path: Path) -> None:
    columns = 0.8
    result = scaled(tmp_path, Target("chessboard", 1.5), distortion=columns)
    details = result["details"]
    assert details["distortion_columns"] == pytest.approx(columns, abs=max(0.05, 3 * details["distortion_std_columns"]))
    assert any("distorts" in note for note in result["notes"])
    value, std = found(result)["pixel_mm"]  # in the middle of the image
    assert abs(value - 0.155) < 3 * std


REFUSED: dict[str, tuple[Target, dict[str, Any], str]] = {
    "turned away": (Target("dots", 1.5, yaw_deg=22.0), {}, "leans by 2[0-4] deg about the vertical"),
    "tipped over": (Target("dots", 1.5, pitch_deg=20.0), {}, r"leans by (19|2[0-1]) deg forwards or backwards"),
    "another pitch": (Target("dots", 2.6), {"pitch_mm": 1.5}, "are seen in a grid"),
    "another target": (Target("chessboard", 1.5), {"kind": "dots", "pitch_mm": 1.0}, "in a grid|no flat target"),
    "in the vial, which is not told": (Target("dots", 1.5), {"in_vial": True, "told_in_air": True}, "--in-vial"),
    "nothing": (Target("dots", 1.5, beside_mm=(200.0, 0.0)), {}, "are seen in a grid"),
}


@pytest.mark.parametrize(("target", "settings", "told"), REFUSED.values(), ids=REFUSED)
def test_what_is_no_such_target_is_refused_with_a_picture(
    target: Target, settings: dict[str, Any], told: str, tmp_path: Path
) -> None:
    if settings.pop("told_in_air", False):
        frame = picture(target, IN_VIAL)
        write_frames(tmp_path / "frames.h5", frame[None], np.zeros(1))
        (tmp_path / "rig.toml").write_text(rig_to_toml(RIG), encoding="utf-8")
        with pytest.raises(InputError, match=told):
            calibrate_scale_by_target(
                tmp_path / "frames.h5", tmp_path / "rig.toml", tmp_path / "new.toml", FlatTarget("dots", 1.5)
            )
    else:
        with pytest.raises(InputError, match=told):
            scaled(tmp_path, target, **settings)
    assert (tmp_path / "new.refused.png").stat().st_size > 1000
    assert not (tmp_path / "new.toml").exists()


def test_saturated_pictures_are_refused(tmp_path: Path) -> None:
    frame = np.minimum(picture(Target("dots", 1.5), IN_AIR), np.uint16(1500))
    write_frames(tmp_path / "frames.h5", frame[None], np.zeros(1))
    (tmp_path / "rig.toml").write_text(rig_to_toml(RIG), encoding="utf-8")
    with pytest.raises(InputError, match="the image is saturated"):
        calibrate_scale_by_target(
            tmp_path / "frames.h5", tmp_path / "rig.toml", tmp_path / "new.toml", FlatTarget("dots", 1.5)
        )


@pytest.mark.parametrize(("changes", "told"), [({"pitch_mm": -1.0}, "--dots"), ({"plane_std_mm": np.nan}, "--plane")])
def test_lengths_that_are_none_are_refused(changes: dict[str, float], told: str) -> None:
    with pytest.raises(InputError, match=told):
        FlatTarget(**{"kind": "dots", "pitch_mm": 1.5, **changes})  # type: ignore[arg-type]
