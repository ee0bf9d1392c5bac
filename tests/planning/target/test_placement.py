"""Placing parts: nothing moves or grows unasked, and what does not fit is refused with the scale that does."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target import Room, place, radius_about_axis

ROOM = Room(8.0, -12.0, 10.0)


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def box(sides_mm: tuple[float, float, float], at_mm: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    body = mesh_of(trimesh.creation.box(sides_mm))
    return Mesh(body.vertices_mm + at_mm, body.faces)


PRISM = Mesh(  # a triangular prism: its smallest circle is not about the middle of its bounding box
    np.array([(x, y, z) for z in (0, 3) for x, y in ((0, 0), (6, 0), (0, 4))], dtype=float),
    np.array([(0, 2, 1), (3, 4, 5), (0, 1, 4), (0, 4, 3), (1, 2, 5), (1, 5, 4), (2, 0, 3), (2, 3, 5)]),
)


def test_a_part_is_centred_and_keeps_its_size() -> None:
    placed = place(box((4, 6, 2), (50, -70, 90)), ROOM)
    assert placed.scale == 1
    np.testing.assert_allclose(placed.mesh.bounds_mm, [[-2, -3, -1], [2, 3, 1]], atol=1e-12)


def test_a_part_is_left_where_it_is_when_asked() -> None:
    part = box((4, 6, 2), (1, -2, 3))
    placed = place(part, ROOM, centre=False)
    np.testing.assert_array_equal(placed.mesh.vertices_mm, part.vertices_mm)
    np.testing.assert_array_equal(placed.matrix, np.eye(4))


def test_matrix_takes_the_given_mesh_to_the_placed_one() -> None:
    placed = place(PRISM, ROOM, rotate_deg=(20, 30, 40), scale=1.3)
    np.testing.assert_allclose(PRISM.moved(placed.matrix).vertices_mm, placed.mesh.vertices_mm, atol=1e-12)
    assert np.linalg.det(placed.matrix[:3, :3]) == pytest.approx(1.3**3)


def test_turns_are_about_x_then_y_then_z() -> None:
    part = box((1, 1, 1), (3, 0, 0))
    middle = place(part, ROOM, rotate_deg=(90, 90, 90), centre=False).mesh.bounds_mm.mean(axis=0)
    # x stays under the turn about x, goes to -z about y, and stays about z.
    np.testing.assert_array_equal(middle, [0, 0, -3])


def test_smallest_circle_goes_about_the_axis() -> None:
    placed = place(PRISM, ROOM)
    assert radius_about_axis(placed.mesh) == pytest.approx(np.hypot(6, 4) / 2)  # a right angle: half its hypotenuse
    assert placed.mesh.bounds_mm.mean(axis=0)[2] == pytest.approx(0)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(*[st.floats(-3, 3)] * 2), min_size=3, max_size=30), st.floats(0, 360))
def test_smallest_circle_is_smallest_and_turns_with_the_part(xy: list[tuple[float, float]], angle_deg: float) -> None:
    points = np.c_[np.array(xy), np.linspace(-2, 2, len(xy))]
    part = Mesh(
        points, np.stack([np.arange(len(xy)), np.roll(np.arange(len(xy)), 1), np.roll(np.arange(len(xy)), 2)], 1)
    )
    placed = place(part, ROOM, scale=1.0)
    turned = place(part, ROOM, scale=1.0, rotate_deg=(0, 0, angle_deg))
    radius = radius_about_axis(placed.mesh)
    assert radius_about_axis(turned.mesh) == pytest.approx(radius, abs=1e-9)
    # Any step to the side makes the circle about the axis larger.
    for shift in np.c_[np.cos(np.arange(12)), np.sin(np.arange(12))] * 1e-3:
        moved = Mesh(placed.mesh.vertices_mm + np.array([*shift, 0]), part.faces)
        assert radius_about_axis(moved) > radius - 1e-9


def test_middle_goes_to_the_plane_of_the_optical_axis_or_as_near_as_the_room_allows() -> None:
    low = place(box((4, 4, 21)), ROOM).mesh.bounds_mm[:, 2]
    np.testing.assert_allclose(low, [-11, 10])  # not the middle of the room, -1, but as near to 0 as it fits
    above = place(box((4, 4, 2)), Room(8, 3, 9)).mesh.bounds_mm[:, 2]
    np.testing.assert_allclose(above, [3, 5])


@pytest.mark.parametrize("sides_mm", [(20, 4, 4), (4, 4, 60), (0.4, 0.3, 0.2), (1e6, 1e6, 1e6)])
@pytest.mark.parametrize("rotate_deg", [(0, 0, 0), (10, 50, 70)])
def test_fit_is_the_largest_that_fits(sides_mm: Any, rotate_deg: Any) -> None:
    part = box(sides_mm, (5, 6, 7))
    placed = place(part, ROOM, rotate_deg=rotate_deg, fit=True)
    assert place(part, ROOM, rotate_deg=rotate_deg, scale=placed.scale).scale == placed.scale
    low, high = placed.mesh.bounds_mm[:, 2]
    assert low >= ROOM.bottom_mm - 1e-9
    assert high <= ROOM.top_mm + 1e-9
    assert radius_about_axis(placed.mesh) <= ROOM.radius_mm + 1e-9
    with pytest.raises(InputError, match="does not fit"):
        place(part, ROOM, rotate_deg=rotate_deg, scale=placed.scale * (1 + 1e-6))


@pytest.mark.parametrize("centre", [True, False])
def test_the_scale_named_in_a_refusal_fits(centre: bool) -> None:
    part = box((30, 4, 4), (1, 0, 0))
    with pytest.raises(InputError, match=r"does not fit: radius .* accepted: radius 8.000 mm.*--scale") as refusal:
        place(part, ROOM, centre=centre)
    found = re.search(r"--scale ([\d.]+)", str(refusal.value))
    assert found is not None
    assert place(part, ROOM, scale=float(found[1]), centre=centre).scale == pytest.approx(float(found[1]))


@pytest.mark.parametrize(
    ("size_mm", "message"),
    [
        (0.012, "largest dimension is 0.012 mm; accepted: 0.8 to 220 mm .* metres, --scale 1000"),
        (0.5, "inches, --scale 25.4, or .* if the size is meant, --scale 1"),
        (12000.0, "micrometres, --scale 0.001"),
        (1e9, "check the unit of the file"),
    ],
)
def test_a_size_that_smells_of_another_unit_is_refused_and_can_be_stated(size_mm: float, message: str) -> None:
    part = box((size_mm, size_mm / 2, size_mm / 3))
    with pytest.raises(InputError, match=message) as refusal:
        place(part, ROOM, where="bracket.stl")
    assert str(refusal.value).startswith("bracket.stl: ")
    if size_mm < 1:
        assert place(part, ROOM, scale=1.0).scale == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"scale": -1.0}, "--scale: is -1.0"),
        ({"scale": float("nan")}, "--scale: is nan"),
        ({"scale": 2.0, "fit": True}, "--scale: 2 and --fit both set the size"),
        ({"rotate_deg": (0.0, float("inf"), 0.0)}, "--rotate"),
    ],
)
def test_impossible_arguments_are_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        place(PRISM, ROOM, **arguments)
