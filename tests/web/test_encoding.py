from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from vialight.core.mesh import Mesh
from vialight.web.encoding import Levels, images_of, pack, pack_surface, to_levels, unpack
from vialight.web.reference import ViewGrid, reference_sums


@given(arrays(np.float32, (5, 7), elements=st.floats(-1e4, 1e5, width=32)))
def test_levels_are_within_half_a_step_of_what_they_stand_for(values: NDArray[np.float32]) -> None:
    image = to_levels(values)
    step = (image.high - image.low) / 254
    back = image.low + (image.levels.astype(np.float64) - 1) * step
    assert np.abs(back - values).max() <= 0.51 * step + 1e-2


def test_what_has_no_value_is_level_0_and_nothing_else_is() -> None:
    values = np.array([[np.nan, 0.0, 5.0]])
    assert to_levels(values).levels.tolist() == [[0, 1, 255]]
    assert to_levels(np.full((2, 2), np.nan)).levels.tolist() == [[0, 0], [0, 0]]


def test_three_planes_share_a_range() -> None:
    grid = ViewGrid((4, 6, 8), 0.5, 0.0)
    box = trimesh.creation.box((2, 1, 1.5))
    sums = reference_sums(Mesh(box.vertices, box.faces), grid)
    images = images_of("cured", sums)
    assert {(image.low, image.high) for image in images.values()} == {(0.0, 2.0)}


def test_a_message_holds_its_arrays_at_multiples_of_8_bytes() -> None:
    given_arrays: dict[str, NDArray[Any] | Levels] = {
        "a": np.arange(3, dtype=np.uint8),
        "b": np.arange(5, dtype=np.float32),
        "c": np.zeros((0, 3), np.int8),
    }
    message = pack({"kind": "x", "value": float("nan")}, given_arrays)
    header, found = unpack(message)
    assert header["value"] is None
    assert (4 + int.from_bytes(message[:4], "little")) % 8 == 0
    assert all(item["offset"] % 8 == 0 for item in header["arrays"].values())
    for name, array in given_arrays.items():
        assert isinstance(array, np.ndarray)
        assert np.array_equal(found[name], array)
        assert found[name].dtype == array.dtype


def test_a_surface_comes_through_to_a_fraction_of_a_micrometre_with_normals_outwards() -> None:
    ball = trimesh.creation.icosphere(3, 8.0)
    header, found = unpack(pack_surface({}, ball.vertices, ball.faces, ball.vertices[:, 0] / 10))
    points = np.array(header["low_mm"]) + found["vertices"] / 65535 * np.array(header["extent_mm"])
    assert np.abs(points - ball.vertices).max() < 2e-4
    assert np.einsum("ij,ij->i", found["normals"] / 127, ball.vertices / 8).min() > 0.99
    assert np.abs(found["deviation"] * header["deviation_unit_mm"] - ball.vertices[:, 0] / 10).max() < 1e-4
    assert not header["simplified"]


def test_an_empty_surface_is_a_message_too() -> None:
    header, found = unpack(pack_surface({"kind": "surface"}, np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros(0)))
    assert found["faces"].shape == (0, 3)
    assert header["kind"] == "surface"


def test_a_mesh_that_is_too_fine_is_simplified_says_so_and_keeps_its_shape() -> None:
    ball = trimesh.creation.icosphere(6, 8.0)
    header, found = unpack(pack_surface({}, ball.vertices, ball.faces, most_faces=8_000))
    points = np.array(header["low_mm"]) + found["vertices"] / 65535 * np.array(header["extent_mm"])
    assert header["simplified"]
    assert 2_000 < len(found["faces"]) < 12_000
    coarse = Mesh(points, found["faces"].astype(np.int64))
    assert coarse.is_closed
    assert coarse.volume_mm3 == pytest.approx(4 / 3 * np.pi * 8**3, rel=0.03)


def test_the_reference_is_as_thick_as_it_is_and_lies_where_the_grid_has_it() -> None:
    box = trimesh.creation.box((2, 4, 6))
    moved = Mesh(box.vertices + np.array([1.0, 0.5, 3.0]), box.faces)
    sums = reference_sums(moved, ViewGrid((80, 60, 60), 0.1, 2.0))
    volumes = [image.sum() * 0.01 for image in sums]
    assert volumes == pytest.approx([48.0] * 3, rel=1e-6)
    z, x = np.nonzero(sums.xz > 3.9)
    assert (x.min(), x.max() + 1) == (30, 50)  # 0 to 2 mm of -3 to 3
    assert (z.min(), z.max() + 1) == (20, 80)  # 0 to 6 mm of -2 to 6
    y, _ = np.nonzero(sums.xy)
    assert (y.min(), y.max() + 1) == (15, 55)
    z, y = np.nonzero(sums.yz)
    assert (y.min(), y.max() + 1, z.min(), z.max() + 1) == (15, 55, 20, 80)
