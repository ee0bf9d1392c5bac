"""Reading meshes, and what any mesh has."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh, merge_coincident, piece_labels
from vialight.store.foreign.meshes import load_mesh


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


SPHERE = trimesh.creation.icosphere(subdivisions=3, radius=2.0)


@pytest.fixture
def stl(tmp_path: Path) -> Path:
    path = tmp_path / "sphere.stl"
    SPHERE.export(path)
    return path


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj"])
def test_what_is_written_is_read_with_faces_in_order(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sphere{suffix}"
    SPHERE.export(path)
    mesh = load_mesh(path)
    assert len(mesh.vertices_mm) == len(SPHERE.vertices)
    np.testing.assert_allclose(mesh.corners_mm, SPHERE.triangles, atol=1e-6)
    assert mesh.is_closed


def test_ascii_stl_is_read(tmp_path: Path) -> None:
    path = tmp_path / "sphere.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(SPHERE))
    np.testing.assert_allclose(load_mesh(path).corners_mm, SPHERE.triangles, atol=1e-6)


def test_binary_stl_whose_header_says_solid_is_read(stl: Path) -> None:
    stl.write_bytes(b"solid".ljust(80) + stl.read_bytes()[80:])
    assert len(load_mesh(stl).faces) == len(SPHERE.faces)


@pytest.mark.parametrize(("unit", "in_mm"), [("inch", 25.4), ("meter", 1000), ("micron", 0.001), (None, 1)])
def test_3mf_is_read_in_mm(tmp_path: Path, unit: str | None, in_mm: float) -> None:
    path = tmp_path / "part.3mf"
    _write_3mf(path, unit)
    np.testing.assert_allclose(load_mesh(path).extents_mm, in_mm)


def test_3mf_is_read_as_it_is_to_be_built(tmp_path: Path) -> None:
    path = tmp_path / "part.3mf"
    _write_3mf(path, "inch", '<item objectid="1"/><item objectid="1" transform="-1 0 0 0 1 0 0 0 1 5 0 0"/>')
    mesh = load_mesh(path)
    np.testing.assert_allclose(mesh.bounds_mm, np.array([[0, 0, 0], [5, 1, 1]]) * 25.4)
    assert mesh.volume_mm3 == pytest.approx(2 * 25.4**3 / 6)  # a mirrored object is not inside out


def test_a_missing_package_is_named(stl: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def load(*_: object, **__: object) -> None:
        raise ModuleNotFoundError("No module named 'lxml'")

    monkeypatch.setattr(trimesh, "load_mesh", load)
    with pytest.raises(InputError, match="needs the package lxml"):
        load_mesh(stl)


def _write_3mf(path: Path, unit: str | None, items: str = '<item objectid="1"/>') -> None:
    import zipfile

    stated = f'unit="{unit}"' if unit else ""
    corners = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
    triangles = [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)]
    model = (
        f'<?xml version="1.0"?><model {stated} '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02"><resources><object id="1" type="model">'
        "<mesh><vertices>"
        + "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in corners)
        + "</vertices><triangles>"
        + "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in triangles)
        + f"</triangles></mesh></object></resources><build>{items}</build></model>"
    )
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("3D/3dmodel.model", model)


def _make_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def _cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2 + 7])


def _with_nan(path: Path) -> None:
    content = bytearray(path.read_bytes())
    content[84 + 12 : 84 + 16] = np.float32(np.nan).tobytes()
    path.write_bytes(content)


FAULTS: dict[str, tuple[Callable[[Path], object], str]] = {
    "missing": (Path.unlink, "cannot be read"),
    "a folder": (_make_folder, "cannot be read"),
    "no bytes": (lambda path: path.write_bytes(b""), "is empty"),
    "no triangles": (lambda path: path.write_bytes(bytes(84)), "holds no triangles"),
    "text": (lambda path: path.write_text("hello\n"), "is not a mesh"),
    "solid text": (lambda path: path.write_text("solid advice, but no mesh at all\n"), "is not a mesh"),
    "long text": (lambda path: path.write_text("hello " * 99), "cut short, or not a mesh"),
    "cut": (_cut, "639 of 1280 announced triangles"),
    "nan": (_with_nan, "1 of 643 vertices have NaN"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_unusable_stl_is_refused_in_one_line_that_names_it(stl: Path, fault: str) -> None:
    spoil, message = FAULTS[fault]
    spoil(stl)
    with pytest.raises(InputError, match=message) as caught:
        load_mesh(stl)
    assert str(caught.value).startswith(str(stl))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", [".ply", ".obj"])
def test_other_formats_cut_short_are_refused(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"sphere{suffix}"
    SPHERE.export(path)
    _cut(path)
    with pytest.raises(InputError, match="cut short"):
        load_mesh(path)


def test_ascii_stl_cut_short_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "sphere.stl"
    path.write_text(trimesh.exchange.stl.export_stl_ascii(SPHERE))
    _cut(path)
    with pytest.raises(InputError, match="endsolid"):
        load_mesh(path)


def test_points_without_faces_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "points.ply"
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    )
    with pytest.raises(InputError, match="no triangles"):
        load_mesh(path)


def test_unknown_suffix_lists_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.stl, \.ply, \.obj, \.3mf"):
        load_mesh(tmp_path / "part.step")


def test_measures_of_a_box_are_exact() -> None:
    box = mesh_of(trimesh.creation.box((1, 2, 3)))
    assert box.volume_mm3 == pytest.approx(6)
    assert box.area_mm2 == pytest.approx(22)
    np.testing.assert_allclose(box.extents_mm, [1, 2, 3])
    np.testing.assert_allclose(box.face_areas_mm2 @ box.face_normals, 0, atol=1e-12)
    outward = np.einsum("ij,ij->i", box.face_normals, box.corners_mm.mean(axis=1))
    assert (outward > 0).all()


def test_volume_does_not_depend_on_where_the_mesh_lies() -> None:
    box = trimesh.creation.box((1, 2, 3))
    box.apply_translation((1e5, -1e5, 1e5))
    assert mesh_of(box).volume_mm3 == pytest.approx(6, rel=1e-9)


def test_a_hole_makes_it_open_and_a_turned_face_too() -> None:
    box = mesh_of(trimesh.creation.box((1, 2, 3)))
    turned = box.faces.copy()
    turned[0] = turned[0, ::-1]
    assert box.is_closed
    assert not Mesh(box.vertices_mm, box.faces[1:]).is_watertight
    assert not Mesh(box.vertices_mm, turned).is_watertight


def test_inside_out_is_watertight_but_not_closed() -> None:
    box = mesh_of(trimesh.creation.box((1, 2, 3)))
    inside_out = Mesh(box.vertices_mm, box.faces[:, ::-1])
    assert inside_out.is_watertight
    assert not inside_out.is_closed


def _joined(one: trimesh.Trimesh, other: trimesh.Trimesh) -> tuple[np.ndarray, np.ndarray]:
    return np.vstack([one.vertices, other.vertices]), np.vstack([one.faces, other.faces + len(one.vertices)])


def test_bodies_touching_along_an_edge_are_closed() -> None:
    one, other = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    other.apply_translation((1, 1, 0))
    assert Mesh(*merge_coincident(*_joined(one, other))).is_closed


def test_collapsed_faces_do_not_open_a_mesh() -> None:
    box = mesh_of(trimesh.creation.box((1, 2, 3)))
    assert Mesh(box.vertices_mm, np.vstack([box.faces, [[0, 0, 1]]])).is_closed


def test_separate_bodies_are_separate_pieces() -> None:
    far = SPHERE.copy()
    far.apply_translation((9, 0, 0))
    labels = piece_labels(Mesh(*_joined(SPHERE, far)))
    assert np.bincount(labels).tolist() == [1280, 1280]


def test_bounds_ignore_vertices_that_no_face_uses() -> None:
    box = mesh_of(trimesh.creation.box((1, 2, 3)))
    np.testing.assert_allclose(Mesh(np.vstack([box.vertices_mm, [[99, 0, 0]]]), box.faces).extents_mm, [1, 2, 3])


@pytest.mark.parametrize(
    ("vertices", "faces", "message"),
    [
        (np.zeros((3, 2)), [[0, 1, 2]], r"shape \(3, 2\)"),
        (np.zeros((0, 3)), [[0, 1, 2]], r"shape \(0, 3\)"),
        (np.eye(3), [[0, 1, 3]], "faces name vertices 0 to 3"),
        (np.eye(3), [[0, 1, -1]], "faces name vertices -1 to 1"),
    ],
)
def test_arrays_that_make_no_mesh_are_refused(vertices: np.ndarray, faces: list[list[int]], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Mesh(vertices, np.array(faces))


def test_importing_mesh_and_surface_loads_nothing_heavy() -> None:
    code = (
        "import sys, vialight.core.mesh, vialight.metrology.surface;"
        "print([name for name in ('trimesh', 'vtkmodules', 'pyvista', 'scipy', 'matplotlib') if name in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert result.stdout.strip() == "[]"
