"""Mesh files that would unpack, grow or point to what they are not are refused in time."""

from __future__ import annotations

import os
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

from hostile import LONGEST_S, refused
from vialight.core.errors import InputError
from vialight.store.foreign.meshes import load_mesh

CORNER = (
    '<mesh><vertices><vertex x="0" y="0" z="0"/><vertex x="2" y="0" z="0"/><vertex x="0" y="3" z="0"/>'
    '<vertex x="0" y="0" z="4"/></vertices><triangles><triangle v1="0" v2="2" v3="1"/><triangle v1="0" v2="1" v3="3"/>'
    '<triangle v1="0" v2="3" v3="2"/><triangle v1="1" v2="2" v3="3"/></triangles></mesh>'
)
OBJECT = f'<object id="0">{CORNER}</object>'
ITEM = '<build><item objectid="0"/></build>'


def of_components(number: int, *of: int) -> str:
    inner = "".join(f'<component objectid="{one}"/>' for one in of)
    return f'<object id="{number}"><components>{inner}</components></object>'


def write_3mf(path: Path, content: str, before: str = "", **others: str) -> Path:
    namespaces = (
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02" '
        'xmlns:p="http://schemas.microsoft.com/3dmanufacturing/production/2015/06"'
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, part in {"3D/3dmodel": content, **others}.items():
            archive.writestr(f"{name}.model", f'{before}<model unit="millimeter" {namespaces}>{part}</model>')
    return path


def test_objects_of_objects_are_built_where_each_has_its_place(tmp_path: Path) -> None:
    moved = '<component objectid="0" transform="0 1 0 -1 0 0 0 0 1 10 0 0"/><component objectid="0"/>'
    pair = f'<object id="5"><components>{moved}</components></object>'
    build = '<build><item objectid="5" transform="1 0 0 0 1 0 0 0 -1 0 0 1"/></build>'
    mesh = load_mesh(write_3mf(tmp_path / "pair.3mf", OBJECT + pair + build))
    assert mesh.volume_mm3 == pytest.approx(8.0)
    np.testing.assert_allclose(mesh.bounds_mm, [[0, 0, -3], [10, 3, 1]])


def test_parts_of_an_archive_are_found_by_their_names(tmp_path: Path) -> None:
    holder = '<object id="1"><components><component p:path="/3D/Objects/a.model" objectid="0"/></components></object>'
    content = holder + '<build><item objectid="1"/></build>'
    assert load_mesh(write_3mf(tmp_path / "a.3mf", content, **{"3D/Objects/a": OBJECT})).volume_mm3 == 4


def test_3mf_and_stl_of_a_part_are_the_same_mesh(tmp_path: Path) -> None:
    part = trimesh.creation.icosphere(subdivisions=2)
    part.export(tmp_path / "part.3mf")
    mesh = load_mesh(tmp_path / "part.3mf")
    assert np.array_equal(mesh.faces, part.faces)
    np.testing.assert_allclose(mesh.vertices_mm, part.vertices, atol=1e-6)


def test_components_that_double_at_each_level_are_counted_and_not_built(tmp_path: Path) -> None:
    levels = "".join(of_components(number, number - 1, number - 1) for number in range(1, 30))
    path = write_3mf(tmp_path / "laughs.3mf", OBJECT + levels + '<build><item objectid="29"/></build>')
    assert "is built of 5.369e+08 objects" in refused(load_mesh, path)
    nothing = OBJECT.replace(CORNER, "") + levels + '<build><item objectid="29"/></build>'
    assert "no triangles" in refused(load_mesh, write_3mf(path, nothing))


def test_components_of_which_nothing_comes_are_not_followed_for_each_that_names_them(tmp_path: Path) -> None:
    nothing = '<object id="7"/>'
    holder = '<object id="8"><components>' + '<component objectid="7"/>' * 20_000 + "</components></object>"
    content = OBJECT + nothing + holder.replace("<components>", '<components><component objectid="0"/>')
    content += of_components(9, *[8] * 20_000) + '<build><item objectid="9"/></build>'
    path = write_3mf(tmp_path / "part.3mf", content)
    began = time.monotonic()
    mesh = load_mesh(path)
    assert time.monotonic() - began < LONGEST_S
    assert len(mesh.faces) == 4 * 20_000


@pytest.mark.parametrize("levels", [1, 2])
def test_objects_that_are_named_too_often_are_refused_as_they_are_read(tmp_path: Path, levels: int) -> None:
    named = [of_components(number, *[0] * (120_000 // levels)) for number in range(1, 1 + levels)]
    path = write_3mf(tmp_path / "part.3mf", OBJECT.replace(CORNER, "") + "".join(named) + ITEM)
    assert "names objects more than 100000 times" in refused(load_mesh, path)


@pytest.mark.parametrize("begin", ['<vertex x="', "<!--", "<a", "<?a "])
def test_a_tag_without_an_end_is_not_read_again_and_again(tmp_path: Path, begin: str) -> None:
    path = write_3mf(tmp_path / "part.3mf", begin + "1" * 30_000_000)
    assert "no tag in" in refused(load_mesh, path)


def test_components_in_circles_are_refused(tmp_path: Path) -> None:
    circle = of_components(1, 2, 2) + of_components(2, 1, 1) + of_components(3, *range(3))
    path = write_3mf(tmp_path / "circle.3mf", OBJECT + circle + '<build><item objectid="3"/></build>')
    assert "in circles" in refused(load_mesh, path)


@pytest.mark.parametrize("filling", [" " * 100_000, '<vertex x="1" y="1" z="1"/>' * 4000])
def test_a_3mf_that_unpacks_to_gigabytes_is_refused(tmp_path: Path, filling: str) -> None:
    path = tmp_path / "bomb.3mf"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("3D/3dmodel.model", "w") as member:
        for _ in range(4000):
            member.write(filling.encode())
    assert "would unpack to" in refused(load_mesh, path)


def test_entities_are_not_expanded(tmp_path: Path) -> None:
    laughs = "".join(f'<!ENTITY l{k} "{f"&l{k - 1};" * 10}">' for k in range(1, 10))
    before = f'<!DOCTYPE model [<!ENTITY l0 "ha">{laughs}]>'
    path = write_3mf(tmp_path / "laughs.3mf", f"<metadata>&l9;</metadata>{OBJECT}{ITEM}", before)
    assert "document type" in refused(load_mesh, path)
    outside = '<!DOCTYPE model [<!ENTITY passwd SYSTEM "file:///etc/passwd">]>'
    path = write_3mf(path, f"<metadata>&passwd;</metadata>{OBJECT}{ITEM}", outside)
    assert "document type" in refused(load_mesh, path)


@pytest.mark.parametrize(
    "content",
    [
        OBJECT,
        OBJECT.replace('v3="1"', 'v3="7"') + ITEM,
        OBJECT.replace('v3="1"', f'v3="{"9" * 5000}"') + ITEM,
        OBJECT.replace('x="2"', 'x="nan"') + ITEM,
        OBJECT.replace('x="2"', 'x="1e999"') + ITEM,
        "<a>" * 100_000,
        OBJECT + ITEM.replace("/>", ' transform="1 2 3"/>'),
        OBJECT + ITEM.replace('"0"', '"9"'),
        "",
    ],
)
def test_a_3mf_that_makes_no_mesh_is_refused(tmp_path: Path, content: str) -> None:
    with pytest.raises(InputError) as caught:
        load_mesh(write_3mf(tmp_path / "part.3mf", content))
    assert "\n" not in str(caught.value)


def test_an_archive_of_endless_entries_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "many.3mf", "w") as archive:
        for number in range(70_000):
            archive.writestr(str(number), b"")
    assert "too many entries" in refused(load_mesh, tmp_path / "many.3mf")


HEAD = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face {}\nproperty list uint int vertex_indices\nend_header\n"


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(5000)),
        ("a.stl", b"solid".ljust(80) + b"\xff\xff\xff\xff" + bytes(5000)),
        ("a.ply", (HEAD + FACES).format(2**62, 2**62).encode() + bytes(500)),
        ("a.ply", (HEAD + FACES).format(3, 1).encode() + bytes(36) + b"\xff" * 16),
        ("a.ply", HEAD.format(3).replace("binary_little_endian", "ascii").encode() + b"end_header\n0 0 0\n"),
        ("a.ply", b"ply\nformat ascii 1.0\n" + b"element vertex 0\n" * 100_000),
        ("a.obj", b"v 0 0 0\n" * 3 + b"f 1 2 " + b"9" * 5000 + b"\n"),
        ("a.obj", b"v 1e999 0 0\n" * 3 + b"f 1 2 3\n"),
        ("a.obj", b"f 1 2 3\n" * 100_000),
        ("a.3mf", b"PK\x05\x06" + bytes(18)),
    ],
)
def test_counts_that_are_only_stated_are_refused(tmp_path: Path, name: str, content: bytes) -> None:
    path = tmp_path / name
    path.write_bytes(content)
    assert refused(load_mesh, path).startswith(str(path))


def test_materials_and_textures_in_other_files_are_not_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd /etc/hostname\n")
    path = tmp_path / "a.obj"
    path.write_text("mtllib secret.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")

    def opened(name: object, *_: object, **__: object) -> None:
        pytest.fail(f"{name} was opened")

    monkeypatch.setattr("builtins.open", opened)
    assert len(load_mesh(path).faces) == 1


@pytest.mark.parametrize("suffix", [".stl", ".ply", ".obj", ".3mf"])
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path, suffix: str) -> None:
    os.mkfifo(tmp_path / f"pipe{suffix}")
    assert "is a pipe" in refused(load_mesh, tmp_path / f"pipe{suffix}")
    (tmp_path / f"zero{suffix}").symlink_to("/dev/zero")
    assert "is a device" in refused(load_mesh, tmp_path / f"zero{suffix}")


def test_a_file_of_holes_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "holes.stl"
    with path.open("wb") as file:
        file.write(bytes(80) + (40_000_000).to_bytes(4, "little"))
        file.truncate(84 + 50 * 40_000_000)
    assert "is all holes" in refused(load_mesh, path)
