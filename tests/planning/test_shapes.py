"""Generated parts have the sizes that were asked for, and are sound."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from vialight.core.arrays import Grid, Volume
from vialight.core.columns import column_grid, thickness
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.metrology import unsigned_distance
from vialight.metrology.surface import isosurface, pieces
from vialight.planning.shapes import bracket, gyroid, thin_wall_box
from vialight.planning.target import check_sound


@pytest.mark.parametrize(
    ("make", "extents_mm"),
    [
        (lambda: gyroid(pitch_mm=0.2), (14, 14, 10)),
        (lambda: gyroid(8, 6, 4, 0.5, pitch_mm=0.125), (8, 8, 6)),
        (lambda: bracket(pitch_mm=0.2), (12, 8, 10)),
        (thin_wall_box, (10, 8, 9)),
    ],
)
def test_parts_are_sound_in_one_piece_and_of_their_size(make: Callable[[], Mesh], extents_mm: Any) -> None:
    part = make()
    check_sound(part)
    assert len(pieces(part)) == 1
    np.testing.assert_allclose(part.extents_mm, extents_mm, atol=0.02)
    np.testing.assert_allclose(part.bounds_mm.sum(axis=0), 0, atol=0.02)
    again = make()
    np.testing.assert_array_equal(part.vertices_mm, again.vertices_mm)
    np.testing.assert_array_equal(part.faces, again.faces)


def test_the_wall_of_a_gyroid_is_as_thick_as_said_everywhere() -> None:
    part = gyroid(pitch_mm=0.125)
    grid = Grid((90, 120, 120), 0.125)
    z, y, x = np.meshgrid(*(2 * np.pi / 7 * axis for axis in (grid.z_mm, grid.y_mm, grid.x_mm)), indexing="ij")
    value = np.sin(x) * np.cos(y) + np.sin(y) * np.cos(z) + np.sin(z) * np.cos(x)
    middle = isosurface(Volume(value.astype(np.float32), grid), 0.0)
    points = part.vertices_mm
    inside = (np.hypot(points[:, 0], points[:, 1]) < 6.8) & (np.abs(points[:, 2]) < 4.8)
    distance = unsigned_distance(points[inside][::7], middle)
    np.testing.assert_allclose(distance, 0.5, atol=0.004)
    assert distance.mean() == pytest.approx(0.5, abs=5e-4)


def test_bracket_has_its_plates_holes_and_rib() -> None:
    part = bracket()
    for axis, diameter_mm in ((2, 2.4), (0, 1.6)):
        shown = thickness(part, column_grid(part.bounds_mm, axis, 0.05))
        plate = shown[:, 160:] if axis == 2 else shown[100:]  # beyond the rib
        assert np.count_nonzero(plate < 0.1) * 0.05**2 == pytest.approx(2 * np.pi * diameter_mm**2 / 4, rel=0.02)
        assert np.median(plate) == pytest.approx(2, abs=1e-3)
    from_above = thickness(part, column_grid(np.array([[-6.0, -4, -5], [6, 4, 5]]), 2, 1.0))
    assert from_above[0, 1] == pytest.approx(10)  # (y, x): the back plate stands on the floor
    assert from_above[0, 7] == pytest.approx(2, abs=1e-3)
    by_hand = 12 * 8 * 2 + 8 * 8 * 2 + 6 * 6 / 2 * 1.6 - 2 * np.pi * (1.2**2 + 0.8**2) * 2
    assert part.volume_mm3 == pytest.approx(by_hand, rel=1e-3)


def test_thin_wall_box_is_open_at_the_top() -> None:
    part = thin_wall_box((10, 8, 9), 0.4)
    from_above = thickness(part, column_grid(part.bounds_mm, 2, 0.1))
    assert from_above[40, 50] == pytest.approx(0.4)
    assert from_above[1, 50] == pytest.approx(9)
    assert part.volume_mm3 == pytest.approx(720 - 9.2 * 7.2 * 8.6)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: gyroid(wall_mm=2.0), "wall_mm: is 2 for a cell of 7 mm and a pitch of 0.1 mm; accepted: 0.2 to 1.75"),
        (lambda: gyroid(wall_mm=0.1), "accepted: 0.2 to 1.75"),
        (lambda: gyroid(diameter_mm=-1.0), "diameter_mm: is -1.0"),
        (lambda: bracket(pitch_mm=float("nan")), "pitch_mm: is nan"),
        (lambda: bracket(pitch_mm=1.0), "pitch_mm: is 1; accepted: up to 0.5"),
        (lambda: thin_wall_box((10, 8, 9), 4), "wall_mm: is 4; accepted: less than 4"),
        (lambda: thin_wall_box((10, 0, 9)), r"sides_mm\[1\]: is 0"),
    ],
)
def test_impossible_lengths_are_refused(make: Callable[[], Mesh], message: str) -> None:
    with pytest.raises(InputError, match=message):
        make()
