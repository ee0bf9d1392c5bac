"""Columns against bodies whose lengths are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from vialight.core.columns import column_grid, crossings, thickness
from vialight.core.mesh import Mesh


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def moved(body: trimesh.Trimesh, shift_mm: tuple[float, float, float]) -> trimesh.Trimesh:
    body.apply_translation(shift_mm)
    return body


def box(*sides_mm: float, at: tuple[float, float, float] = (0, 0, 0)) -> trimesh.Trimesh:
    return moved(trimesh.creation.box(sides_mm), at)


TILT = np.eye(4)
TILT[:3, :3] = Rotation.from_rotvec([0.19, 0.09, 0]).as_matrix()


def joined(*bodies: trimesh.Trimesh) -> Mesh:
    whole = trimesh.util.concatenate(bodies)
    assert isinstance(whole, trimesh.Trimesh)
    return mesh_of(whole)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_thickness_sums_to_the_volume_and_is_never_negative(axis: int) -> None:
    part = joined(box(9, 5, 2), box(1, 2, 3, at=(-3, 1, 3)), moved(trimesh.creation.cylinder(1.2, 4), (2.5, 0.7, 3.2)))
    turned = part.moved(TILT)
    grid = column_grid(turned.bounds_mm, axis, 0.05)
    lengths = thickness(turned, grid)
    assert lengths.min() > -1e-9
    assert lengths.sum() * 0.05**2 == pytest.approx(turned.volume_mm3, rel=2e-3)


def test_projection_is_not_mirrored() -> None:
    wedge = joined(box(1, 1, 1), box(1, 1, 2, at=(4, 0, 0)), box(1, 1, 3, at=(0, 8, 0)))
    lengths = thickness(wedge, column_grid(wedge.bounds_mm, 2, 0.5))  # (v, u) = (y, x)
    assert lengths.shape == (18, 10)
    assert (lengths[0, 0], lengths[0, -1], lengths[-1, 0], lengths[-1, -1]) == (1, 2, 3, 0)
    lengths = thickness(wedge, column_grid(wedge.bounds_mm, 0, 0.5))  # (v, u) = (z, y)
    assert lengths.shape == (6, 18)
    assert (lengths[2, 0], lengths[2, -1], lengths[0, -1]) == (2, 1, 1)


def test_columns_that_hit_edges_and_corners_exactly_are_counted_once() -> None:
    fan = mesh_of(trimesh.creation.box((4, 4, 4)).subdivide().subdivide())
    bounds = fan.bounds_mm + np.array([[-0.5], [0.5]])
    lengths = thickness(fan, column_grid(bounds, 2, 1.0))  # columns at whole numbers, where the edges are
    assert set(np.unique(lengths)) == {0.0, 4.0}
    assert np.count_nonzero(lengths) == 16


def test_crossings_come_in_pairs_and_lie_on_their_faces() -> None:
    ball = mesh_of(trimesh.creation.icosphere(subdivisions=3, radius=2.0))
    grid = column_grid(ball.bounds_mm, 2, 0.1)
    found = crossings(ball, grid)
    assert not np.bincount(found.column, weights=found.outward).any()
    points = np.einsum("nc,nci->ni", found.shares, ball.corners_mm[found.face])
    np.testing.assert_allclose(points[:, 2], found.height_mm, atol=1e-12)
    np.testing.assert_allclose(points[:, 0], grid.low_uv_mm[0] + (found.column % grid.shape[1] + 0.5) * 0.1)
