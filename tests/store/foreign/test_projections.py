"""Projections computed elsewhere come in the right way round, or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from vialight.core.errors import InputError
from vialight.store import read_projections

VALUES = np.random.default_rng(3).integers(0, 256, (12, 5, 7)).astype(np.uint8)  # (angle, row, column)


@pytest.mark.parametrize(
    ("axes", "stored"),
    [
        ("angle,row,column", VALUES),
        ("column,angle,-row", VALUES[:, ::-1].transpose(2, 0, 1)),
        ("row, -column, angle", VALUES[:, :, ::-1].transpose(1, 2, 0)),
        ("-angle,row,column", VALUES[::-1]),
    ],
)
def test_axes_are_put_in_order_and_turned_round_as_said(tmp_path: Path, axes: str, stored: np.ndarray) -> None:
    path = tmp_path / "projections.npy"
    np.save(path, stored)
    values, angles = read_projections(path, axes=axes, span_deg=180)
    np.testing.assert_array_equal(values, VALUES)
    assert values.dtype == np.float32
    assert values.flags.c_contiguous
    np.testing.assert_allclose(np.degrees(angles), np.arange(12) * 15)


def test_listed_angles_follow_an_axis_that_is_turned_round(tmp_path: Path) -> None:
    np.save(tmp_path / "projections.npy", VALUES[::-1])
    listed = np.arange(12)[::-1] * 30.0
    values, angles = read_projections(tmp_path / "projections.npy", axes="-angle,row,column", angles=listed)
    np.testing.assert_array_equal(values, VALUES)
    np.testing.assert_allclose(np.degrees(angles), np.arange(12) * 30)


@pytest.mark.parametrize("kind", ["npy", "txt", "list", "radians"])
def test_angles_come_from_files_and_lists(tmp_path: Path, kind: str) -> None:
    np.save(tmp_path / "projections.npy", VALUES)
    angles: Any = np.arange(12) * 30.0
    np.save(tmp_path / "angles.npy", angles)
    np.savetxt(tmp_path / "angles.txt", angles)
    given = {"list": angles.tolist(), "radians": np.radians(angles)}.get(kind, tmp_path / f"angles.{kind}")
    unit: Any = "rad" if kind == "radians" else "deg"
    _, found = read_projections(tmp_path / "projections.npy", axes="angle,row,column", angles=given, angle_unit=unit)
    np.testing.assert_allclose(found, np.radians(angles))


def test_an_archive_gives_its_only_stack_or_the_named_one(tmp_path: Path) -> None:
    np.savez(tmp_path / "one.npz", angles=np.arange(12), stack=VALUES)
    np.savez(tmp_path / "two.npz", first=VALUES, second=VALUES + 1.0)
    assert read_projections(tmp_path / "one.npz", axes="angle,row,column", span_deg=360)[0].shape == (12, 5, 7)
    values, _ = read_projections(tmp_path / "two.npz", axes="angle,row,column", span_deg=360, name="second")
    np.testing.assert_array_equal(values, VALUES + 1.0)
    with pytest.raises(InputError, match="holds the arrays first, second"):
        read_projections(tmp_path / "two.npz", axes="angle,row,column", span_deg=360)
    with pytest.raises(InputError, match="holds the arrays first, second"):
        read_projections(tmp_path / "two.npz", axes="angle,row,column", span_deg=360, name="third")


@pytest.mark.parametrize(("dtype", "suffix"), [(np.uint8, "png"), (np.uint16, "png"), (np.float32, "tif")])
def test_a_folder_of_images_is_read_in_the_order_of_its_numbers(tmp_path: Path, dtype: Any, suffix: str) -> None:
    stack = VALUES.astype(dtype) * (3 if dtype != np.uint8 else 1)
    for index, image in enumerate(stack):
        Image.fromarray(image).save(tmp_path / f"slice{index}.{suffix}")  # 10 before 2 by letters
    (tmp_path / "notes.txt").write_text("not an image")
    values, _ = read_projections(tmp_path, axes="angle,row,column", span_deg=360)
    np.testing.assert_array_equal(values, stack)


def test_a_tiff_of_many_pages_is_a_stack(tmp_path: Path) -> None:
    first, *others = [Image.fromarray(image.astype(np.float32) / 7) for image in VALUES]
    first.save(tmp_path / "stack.tif", save_all=True, append_images=others)
    values, _ = read_projections(tmp_path / "stack.tif", axes="angle,row,column", span_deg=360)
    np.testing.assert_array_equal(values, VALUES.astype(np.float32) / 7)


def test_colours_are_refused_unless_they_are_grey(tmp_path: Path) -> None:
    Image.fromarray(np.repeat(VALUES[0][..., None], 3, axis=2)).save(tmp_path / "1.png")
    assert read_projections(tmp_path, axes="angle,row,column", span_deg=360)[0].shape == (1, 5, 7)
    Image.fromarray(np.eye(3, dtype=np.uint8)[None] * np.uint8(9)).save(tmp_path / "1.png")
    with pytest.raises(InputError, match="has colours"):
        read_projections(tmp_path, axes="angle,row,column", span_deg=360)


@pytest.mark.parametrize(
    ("stored", "arguments", "message"),
    [
        (VALUES, {"axes": "angle,row"}, "--axes: is 'angle,row'"),
        (VALUES, {"axes": "angle,row,z"}, "accepted: angle, row and column"),
        (VALUES, {"span_deg": None}, "needs its angles"),
        (VALUES, {"angles": np.arange(12)}, "needs its angles, said in one way"),
        (VALUES, {"span_deg": 90}, "--span: is 90"),
        (VALUES, {"span_deg": None, "angles": np.arange(5)}, r"holds angles of shape \(5,\); accepted: 12"),
        (VALUES, {"span_deg": None, "angles": [np.nan] * 12}, "NaN or infinite"),
        (VALUES, {"span_deg": None, "angles": np.linspace(0, 6.2, 12)}, "spans 6.2 degrees.*radians"),
        (VALUES, {"span_deg": None, "angles": "missing.txt"}, "missing.txt: is no list of angles"),
        (VALUES[0], {}, r"is uint8 of shape \(5, 7\)"),
        (VALUES * 1j, {}, "is complex128"),
        (VALUES - 1.0 * (VALUES == 0) - 0.5, {}, "holds negative values, down to"),
        (VALUES / np.where(VALUES.max() == VALUES, np.nan, 1), {}, "NaN or infinite; accepted: finite light"),
        (np.array([None] * 3), {}, "is damaged, or not what its name says"),
    ],
)
def test_what_does_not_fit_is_refused(
    tmp_path: Path, stored: np.ndarray, arguments: dict[str, Any], message: str
) -> None:
    np.save(tmp_path / "projections.npy", stored)
    usual: dict[str, Any] = {"axes": "angle,row,column", "span_deg": 360}
    with pytest.raises(InputError, match=message):
        read_projections(tmp_path / "projections.npy", **(usual | arguments))


def test_files_of_other_kinds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "broken.tif").write_bytes(b"II*\0broken")
    (tmp_path / "stack.mat").write_bytes(b"")
    (tmp_path / "empty").mkdir()
    for name, message in (
        ("missing.npy", "there is no such file"),
        ("stack.mat", r"is of no kind that is read \(.mat\)"),
        ("broken.tif", "is damaged, or not what its name says"),
        ("empty", "holds no images"),
    ):
        with pytest.raises(InputError, match=message):
            read_projections(tmp_path / name, axes="angle,row,column", span_deg=360)


def test_images_of_different_sizes_are_refused(tmp_path: Path) -> None:
    Image.fromarray(VALUES[0]).save(tmp_path / "1.png")
    Image.fromarray(VALUES[0, 1:]).save(tmp_path / "2.png")
    with pytest.raises(InputError, match=r"1.png is uint8 .* 2.png is uint8"):
        read_projections(tmp_path, axes="angle,row,column", span_deg=360)
