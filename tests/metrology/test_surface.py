"""The isosurface against bodies whose surface is known exactly."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from vialight.core.arrays import Float32Array, Grid, Volume
from vialight.core.errors import InputError
from vialight.metrology.surface import isosurface, pieces
from vialight.store.foreign.meshes import load_mesh

GRID = Grid((40, 48, 56), 0.1, centre_z_mm=3.0)


def coordinates(grid: Grid) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij", sparse=True)
    return x, y, z


def ball(grid: Grid, centre_mm: tuple[float, float, float], radius_mm: float) -> Float32Array:
    """A density that is 100 on the sphere, and falls outwards by 100 per mm."""
    x, y, z = coordinates(grid)
    distance = np.sqrt((x - centre_mm[0]) ** 2 + (y - centre_mm[1]) ** 2 + (z - centre_mm[2]) ** 2)
    return (100 * (1 + radius_mm - distance)).astype(np.float32)


def test_sphere_off_centre_lies_where_it_should() -> None:
    centre = (0.9, -0.4, 3.3)
    mesh = isosurface(Volume(ball(GRID, centre, 1.2), GRID), 100)
    radii = np.linalg.norm(mesh.vertices_mm - centre, axis=1)
    np.testing.assert_allclose(radii, 1.2, atol=0.1**2 / 4)
    assert mesh.is_closed
    assert mesh.volume_mm3 == pytest.approx(4 / 3 * np.pi * 1.2**3, rel=5e-3)


@settings(max_examples=15, deadline=None)
@given(
    slope=st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda slope: np.linalg.norm(slope) > 0.2),
    voxel=st.floats(0.01, 3),
    centre_z=st.floats(-20, 20),
)
def test_plane_is_found_exactly_in_any_grid(slope: tuple[float, float, float], voxel: float, centre_z: float) -> None:
    grid = Grid((8, 9, 10), voxel, centre_z)
    x, y, z = coordinates(grid)
    density = slope[0] * x + slope[1] * y + slope[2] * (z - centre_z)
    vertices = isosurface(Volume(density.astype(np.float32), grid), 0.0).vertices_mm
    half = (np.array(grid.shape[::-1]) - 1) / 2 * voxel * 0.999
    inner = vertices[(np.abs(vertices - [0, 0, centre_z]) < half).all(axis=1)]
    assert len(inner)
    np.testing.assert_allclose((inner - [0, 0, centre_z]) @ slope, 0, atol=1e-5 * voxel * 10 + 1e-5 * abs(centre_z))


def test_a_body_that_leaves_the_grid_is_closed_on_the_grids_outer_faces() -> None:
    x, y, z = coordinates(GRID)
    rod = (200.0 * (np.hypot(x, y) < 1) + 0 * z).astype(np.float32)
    mesh = isosurface(Volume(rod, GRID), 100)
    assert mesh.is_closed
    np.testing.assert_allclose(mesh.bounds_mm[:, 2], [1.0, 5.0], atol=1e-5)


def test_a_body_that_fills_a_corner_of_the_grid_is_closed() -> None:
    density = np.zeros(GRID.shape, dtype=np.float32)
    density[:10, :10, :10] = 200
    mesh = isosurface(Volume(density, GRID), 100)
    assert mesh.is_closed
    np.testing.assert_allclose(mesh.bounds_mm[0], [-2.8, -2.4, 1.0], atol=1e-5)


def test_densities_equal_to_the_threshold_do_not_open_the_surface() -> None:
    density = np.random.default_rng(5).integers(0, 4, (20, 20, 20)).astype(np.float32)
    mesh = isosurface(Volume(density, Grid((20, 20, 20), 0.1)), 2.0)
    assert mesh.is_closed
    assert mesh.volume_mm3 > 0


def test_surface_stays_closed_through_a_file_without_shared_vertices(tmp_path: Path) -> None:
    mesh = isosurface(Volume(ball(GRID, (0, 0, 3), 1.5), GRID), 100)
    path = tmp_path / "surface.stl"
    trimesh.Trimesh(mesh.vertices_mm, mesh.faces, process=False).export(path)
    assert load_mesh(path).is_closed


def test_pieces_are_listed_with_cavities_negative() -> None:
    far = np.maximum(ball(GRID, (-1.5, 0, 3), 1.0), ball(GRID, (1.5, 0, 3), 0.5))
    hollow = np.minimum(far, 200 - ball(GRID, (-1.5, 0, 3), 0.4))
    volumes = pieces(isosurface(Volume(hollow, GRID), 100))
    np.testing.assert_allclose(volumes, 4 / 3 * np.pi * np.array([1.0, 0.125, -0.064]), rtol=0.05)


def test_small_pieces_are_left_out_only_when_asked() -> None:
    two = Volume(np.maximum(ball(GRID, (-1.5, 0, 3), 1.0), ball(GRID, (1.5, 0, 3), 0.5)), GRID)
    assert len(pieces(isosurface(two, 100))) == 2
    kept = isosurface(two, 100, smallest_piece_mm3=1.0)
    assert len(pieces(kept)) == 1
    assert kept.is_closed
    assert kept.bounds_mm[1, 0] < 0
    with pytest.raises(InputError, match="no piece reaches"):
        isosurface(two, 100, smallest_piece_mm3=10.0)


@pytest.mark.parametrize("threshold", [-500.0, 500.0])
def test_empty_surface_tells_the_range_found(threshold: float) -> None:
    volume = Volume(ball(GRID, (0, 0, 3), 1.2), GRID)
    low, high = volume.density.min(), volume.density.max()
    with pytest.raises(InputError, match=f"no surface at {threshold:g}.*{low:.4g} to {high:.4g}"):
        isosurface(volume, threshold)


@pytest.mark.parametrize("threshold", [np.nan, np.inf])
def test_threshold_that_is_no_number_is_refused(threshold: float) -> None:
    with pytest.raises(InputError, match="finite"):
        isosurface(Volume(ball(GRID, (0, 0, 3), 1.2), GRID), threshold)


def test_density_that_is_no_number_is_refused() -> None:
    density = ball(GRID, (0, 0, 3), 1.2)
    density[3, 4, 5] = np.nan
    with pytest.raises(InputError, match="NaN"):
        isosurface(Volume(density, GRID), 100)
