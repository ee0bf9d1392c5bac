"""Voxels against bodies whose inside is known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from vialight.core.arrays import Grid
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target import radius_about_axis, target_grid, voxelise, voxels


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def turned(mesh: Mesh, *angles_deg: float) -> Mesh:
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", angles_deg, degrees=True).as_matrix()
    return mesh.moved(matrix)


BALL = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=3.0))
GRID = Grid((36, 40, 44), 0.2, 0.5)


def test_a_voxel_is_inside_where_its_centre_is() -> None:
    block = turned(mesh_of(trimesh.creation.box((4, 5, 3))), 20, 30, 40)
    z, y, x = np.meshgrid(GRID.z_mm, GRID.y_mm, GRID.x_mm, indexing="ij")
    rotation = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_matrix()
    own = np.abs(np.stack([x, y, z], axis=-1) @ rotation)
    expected = (own < np.array([2, 2.5, 1.5])).all(axis=-1)
    shares = voxelise(block, GRID)
    assert shares.dtype == np.float32
    np.testing.assert_array_equal(shares, expected)


def test_coverage_is_the_share_of_volume() -> None:
    shares = voxelise(BALL, GRID, coverage=True)
    assert shares.sum() * 0.2**3 == pytest.approx(BALL.volume_mm3, rel=2e-4)
    z, y, x = np.meshgrid(GRID.z_mm, GRID.y_mm, GRID.x_mm, indexing="ij")
    radius = np.sqrt(x**2 + y**2 + z**2)
    assert (shares[radius < 2.8] == 1).all()  # exactly: nothing is left of the sums
    assert (shares[radius > 3.2] == 0).all()
    np.testing.assert_allclose(shares, np.clip((3 - radius) / 0.2 + 0.5, 0, 1), atol=0.2)


def test_coverage_along_z_is_exact() -> None:
    plate = mesh_of(trimesh.creation.box((4, 4, 1.1)))
    column = voxelise(plate, Grid((20, 10, 10), 0.2), coverage=True)[:, 5, 5]
    expected = np.clip((0.55 - np.abs(Grid((20, 10, 10), 0.2).z_mm)) / 0.2 + 0.5, 0, 1)
    np.testing.assert_allclose(column, expected, atol=1e-5)


@pytest.mark.parametrize("coverage", [False, True])
def test_x_y_and_z_are_not_exchanged(coverage: bool) -> None:
    block = mesh_of(trimesh.creation.box((4, 2, 1)))
    part = Mesh(block.vertices_mm + np.array([1, 0.8, 0.6]), block.faces)
    shares = voxelise(part, GRID, coverage=coverage).astype(np.float64)
    for axis, middle in (("z", 0.6), ("y", 0.8), ("x", 1.0)):
        position = getattr(GRID, f"{axis}_mm").reshape([-1 if name == axis else 1 for name in "zyx"])
        assert (shares * position).sum() / shares.sum() == pytest.approx(middle, abs=1e-6)


@pytest.mark.parametrize("coverage", [False, True])
def test_faces_may_come_in_any_portions(coverage: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = voxelise(BALL, GRID, coverage=coverage)
    monkeypatch.setattr(voxels, "_FACES_AT_ONCE", 100)
    np.testing.assert_array_equal(voxelise(BALL, GRID, coverage=coverage), whole)


@pytest.mark.parametrize("coverage", [False, True])
def test_what_lies_outside_the_grid_is_cut_off(coverage: bool) -> None:
    small = Grid((6, 8, 10), 0.2, 0.5)
    whole = voxelise(BALL, GRID, coverage=coverage)
    np.testing.assert_array_equal(voxelise(BALL, small, coverage=coverage), whole[15:21, 16:24, 17:27])


def test_bodies_in_each_other_count_once() -> None:
    twice = Mesh(BALL.vertices_mm, np.vstack([BALL.faces, BALL.faces]))
    np.testing.assert_array_equal(voxelise(twice, GRID), voxelise(BALL, GRID))


def test_grid_holds_the_part_and_void_all_round_at_any_angle() -> None:
    part = Mesh(BALL.vertices_mm * [0.5, 1, 1] + [1.0, 0.3, 7], BALL.faces)
    grid = target_grid(part, 0.065, void_voxels=5)
    slices, rows, columns = grid.shape
    assert rows == columns
    assert rows % 2 == 0
    reach = radius_about_axis(part)
    assert reach + 5 * 0.065 <= rows / 2 * 0.065 < reach + 6 * 0.065
    low, high = part.bounds_mm[:, 2]
    assert grid.origin_mm[0] - 0.0325 == pytest.approx(low - 5 * 0.065, abs=0.0325)
    assert slices * 0.065 == pytest.approx(high - low + 10 * 0.065, abs=0.065)
    shares = voxelise(part, grid, coverage=True)
    assert shares.sum() * 0.065**3 == pytest.approx(part.volume_mm3, rel=1e-4)
    assert not shares[:5].any()
    assert not shares[-5:].any()


def test_slices_end_with_a_part_that_is_a_whole_number_of_them() -> None:
    plate = mesh_of(trimesh.creation.box((4, 4, 13 * 0.065)))
    assert target_grid(plate, 0.065, void_voxels=0).shape[0] == 13


@pytest.mark.parametrize("voxel_mm", [0.0, -1.0, float("nan"), 3.0])
def test_a_voxel_that_is_none_is_refused(voxel_mm: float) -> None:
    with pytest.raises(InputError, match=r"--voxel: is .* accepted: more than 0, at most 1.5"):
        target_grid(BALL, voxel_mm)


def test_a_grid_that_no_computer_holds_is_refused() -> None:
    with pytest.raises(InputError, match=r"makes \d+ x \d+ x \d+ voxels; .*use larger voxels"):
        target_grid(BALL, 0.001)
