from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista
import trimesh
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.store import write_ply, write_stl
from vialight.store.foreign.meshes import load_mesh

SOURCE = trimesh.creation.icosphere(subdivisions=2, radius=7.3)
SPHERE = Mesh(np.asarray(SOURCE.vertices) + np.array([0.1, 0.2, 0.3]), np.asarray(SOURCE.faces))


def test_stl_keeps_every_triangle_in_place_order_and_sense(tmp_path: Path) -> None:
    write_stl(tmp_path / "s.stl", SPHERE)
    back = load_mesh(tmp_path / "s.stl")
    assert len(back.vertices_mm) == len(SPHERE.vertices_mm)
    np.testing.assert_array_equal(back.corners_mm, SPHERE.corners_mm.astype(np.float32))


def test_stl_says_millimetres_and_is_not_taken_for_ascii(tmp_path: Path) -> None:
    write_stl(tmp_path / "s.stl", SPHERE)
    content = (tmp_path / "s.stl").read_bytes()
    assert content.startswith(b"vialight: binary STL, lengths in mm ")
    assert len(content) == 84 + 50 * len(SPHERE.faces)


def test_stl_normals_point_outwards(tmp_path: Path) -> None:
    write_stl(tmp_path / "s.stl", SPHERE)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    triangles = np.frombuffer((tmp_path / "s.stl").read_bytes()[84:], record)
    np.testing.assert_allclose(np.linalg.norm(triangles["normal"], axis=1), 1, rtol=1e-6)
    outwards = triangles["corners"].mean(axis=1) - [0.1, 0.2, 0.3]
    assert (np.einsum("ij,ij->i", outwards, triangles["normal"]) > 0).all()


def test_a_face_without_area_has_no_normal_and_no_warning(tmp_path: Path) -> None:
    write_stl(tmp_path / "s.stl", Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]])))
    content = (tmp_path / "s.stl").read_bytes()
    assert content[84:] == bytes(50)


def test_ply_keeps_vertices_faces_values_and_colours(tmp_path: Path) -> None:
    deviation = np.linspace(-0.1, 0.1, len(SPHERE.vertices_mm))
    deviation[3] = np.nan
    colours = np.random.default_rng(0).integers(0, 256, (len(deviation), 3), dtype=np.uint8)
    write_ply(tmp_path / "s.ply", SPHERE, {"deviation_mm": deviation, "thickness_mm": -deviation}, colours)
    back = trimesh.load_mesh(tmp_path / "s.ply", process=False)
    np.testing.assert_array_equal(back.vertices, SPHERE.vertices_mm.astype(np.float32))
    np.testing.assert_array_equal(back.faces, SPHERE.faces)
    assert isinstance(back.visual, trimesh.visual.ColorVisuals)
    np.testing.assert_array_equal(back.visual.vertex_colors[:, :3], colours)
    data = back.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_array_equal(data["deviation_mm"], deviation.astype(np.float32))
    np.testing.assert_array_equal(data["thickness_mm"], -deviation.astype(np.float32))


def test_vtk_reads_the_ply_too(tmp_path: Path) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (len(SPHERE.vertices_mm), 3), dtype=np.uint8)
    write_ply(tmp_path / "s.ply", SPHERE, {"deviation_mm": np.zeros(len(colours))}, colours)
    back = pyvista.read(tmp_path / "s.ply")
    assert isinstance(back, pyvista.PolyData)
    np.testing.assert_array_equal(back.points, SPHERE.vertices_mm.astype(np.float32))
    np.testing.assert_array_equal(back.regular_faces, SPHERE.faces)
    np.testing.assert_array_equal(back["RGB"], colours)


def test_ply_says_millimetres(tmp_path: Path) -> None:
    write_ply(tmp_path / "s.ply", SPHERE)
    assert b"\ncomment vialight: lengths in mm\n" in (tmp_path / "s.ply").read_bytes()


@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    corners=st.lists(st.tuples(*[st.floats(-50, 50, width=32)] * 3), min_size=3, max_size=9, unique=True),
    colour=st.booleans(),
)
def test_single_precision_survives_both_formats(
    tmp_path: Path, corners: list[tuple[float, float, float]], colour: bool
) -> None:
    faces = np.array([[index, (index + 1) % len(corners), (index + 2) % len(corners)] for index in range(len(corners))])
    mesh = Mesh(np.array(corners), faces)
    write_stl(tmp_path / "s.stl", mesh)
    write_ply(tmp_path / "s.ply", mesh, colours=np.zeros((len(corners), 3), np.uint8) if colour else None)
    np.testing.assert_array_equal(load_mesh(tmp_path / "s.stl").corners_mm, mesh.corners_mm)
    np.testing.assert_array_equal(load_mesh(tmp_path / "s.ply").corners_mm, mesh.corners_mm)


@pytest.mark.parametrize("name", ["", "deviation mm", "x", "red", "écart", "1st"])
def test_a_name_that_ply_cannot_hold_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="cannot name a scalar"):
        write_ply(tmp_path / "s.ply", SPHERE, {name: np.zeros(len(SPHERE.vertices_mm))})
    assert not list(tmp_path.iterdir())


def test_values_and_colours_must_fit_the_vertices(tmp_path: Path) -> None:
    count = len(SPHERE.vertices_mm)
    with pytest.raises(InputError, match=rf"deviation_mm has the shape \({count - 1},\)"):
        write_ply(tmp_path / "s.ply", SPHERE, {"deviation_mm": np.zeros(count - 1)})
    with pytest.raises(InputError, match="colours are uint8 of shape"):
        write_ply(tmp_path / "s.ply", SPHERE, colours=np.zeros((count, 4), np.uint8))
    with pytest.raises(InputError, match="colours are float64"):
        write_ply(tmp_path / "s.ply", SPHERE, colours=np.zeros((count, 3)))  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())
