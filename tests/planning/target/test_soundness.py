"""Meshes that do not bound a part are refused; meshes that only look odd are not."""

from __future__ import annotations

import time

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.planning.target import check_sound, intersecting_faces, self_intersection


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def box(sides_mm: tuple[float, float, float], at_mm: tuple[float, float, float] = (0, 0, 0)) -> Mesh:
    body = mesh_of(trimesh.creation.box(sides_mm))
    return Mesh(body.vertices_mm + at_mm, body.faces)


def joined(*meshes: Mesh) -> Mesh:
    offsets = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in meshes[:-1])])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(np.vstack([mesh.vertices_mm for mesh in meshes]), np.vstack(faces))


def flipped(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices_mm, mesh.faces[:, ::-1])


BLOCK = box((4, 4, 4))
BALL = mesh_of(trimesh.creation.icosphere(subdivisions=4, radius=5.0))


@pytest.mark.parametrize(
    "mesh",
    [
        BLOCK,
        mesh_of(trimesh.creation.annulus(1, 3, 8)),
        mesh_of(trimesh.creation.torus(5, 1.5)),
        joined(BLOCK, box((1, 1, 1), (5, 0, 0))),  # two bodies
        joined(BLOCK, flipped(box((1, 1, 1)))),  # a cavity
        joined(BLOCK, box((2, 2, 2), (3, 0, 0))),  # bodies that lie flat against each other
        joined(BLOCK, box((2, 2, 2), (0, 0, 3))),
        Mesh(BALL.vertices_mm.astype(np.float32).astype(float) * 1e-3, BALL.faces),  # in metres
    ],
)
@pytest.mark.parametrize("turned", [False, True])
def test_sound_meshes_pass(mesh: Mesh, turned: bool) -> None:
    rotation = Rotation.from_euler("xyz", [20, 30, 40], degrees=True).as_matrix() if turned else np.eye(3)
    single = (mesh.vertices_mm @ rotation.T).astype(np.float32)  # as STL stores them
    check_sound(Mesh(single.astype(np.float64), mesh.faces))


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (Mesh(BLOCK.vertices_mm, BLOCK.faces[1:]), "not watertight: 3 of its edges have a face on one side only"),
        (Mesh(BLOCK.vertices_mm, np.r_[BLOCK.faces[:1, ::-1], BLOCK.faces[1:]]), "at 3 of its edges .* disagree"),
        (Mesh(BLOCK.vertices_mm, BLOCK.faces[:, [0, 1, 1]]), "no face with three corners"),
        (flipped(BLOCK), r"inside out \(its volume comes out as -64 mm\^3\)"),
        (box((4, 4, 0)), "encloses no volume"),
        (joined(BLOCK, box((3, 3, 3), (2, 1.5, 1))), r"cuts through itself: \d+ pairs of faces, the first at \("),
        (joined(BLOCK, box((4, 4, 4), (2, 2, 0))), "cuts through itself"),  # no edge crosses a face's inside
        (joined(BLOCK, BLOCK), "overlap, or one is in it twice"),
        (joined(BLOCK, box((1, 1, 1))), "overlap, or one is in it twice"),
        (joined(BLOCK, flipped(box((1, 1, 1), (4, 0, 0)))), r"inside out, at \(.*, .*, 0\) mm"),
    ],
)
def test_unsound_meshes_are_refused_with_the_place(mesh: Mesh, message: str) -> None:
    with pytest.raises(InputError, match=message) as refusal:
        check_sound(mesh, "part.stl")
    assert str(refusal.value).startswith("part.stl: ")
    assert "\n" not in str(refusal.value)


def test_a_fold_is_found_where_it_is() -> None:
    vertices = BALL.vertices_mm.copy()
    apex = int(vertices[:, 2].argmax())
    vertices[apex] = [0, 0, -7]  # through the opposite side
    pairs = intersecting_faces(Mesh(vertices, BALL.faces))
    assert len(pairs)
    assert (BALL.faces[pairs] == apex).any(axis=2).any(axis=1).all()


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_cut_triangles_are_those_that_an_edge_pierces(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(40, 1, 3)) + 0.7 * rng.normal(size=(40, 3, 3))
    soup = Mesh(corners.reshape(-1, 3), np.arange(120).reshape(-1, 3))
    expected = {(i, j) for i in range(40) for j in range(i) if pierces(corners[i], corners[j])}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(self_intersection, "_TOLERANCE", 1e-13)  # random cuts can be as small as they like
        assert {(int(b), int(a)) for a, b in intersecting_faces(soup)} == expected


def pierces(one: np.ndarray, two: np.ndarray) -> bool:
    """Solve for where each edge of either triangle meets the plane of the other."""
    for face, other in ((one, two), (two, one)):
        for k in range(3):
            start, end = other[k], other[(k + 1) % 3]
            along, u, v = np.linalg.solve(
                np.stack([end - start, face[0] - face[1], face[0] - face[2]], 1), face[0] - start
            )
            if 0 < along < 1 and u > 0 and v > 0 and u + v < 1:
                return True
    return False


def test_faces_may_be_paired_in_any_portions(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices = BALL.vertices_mm * np.where(np.arange(len(BALL.vertices_mm)) % 50 == 7, -1.1, 1)[:, None]
    folded = Mesh(vertices, BALL.faces)
    whole = intersecting_faces(folded)
    monkeypatch.setattr(self_intersection, "_PAIRS_AT_ONCE", 100)
    assert len(whole)
    assert set(map(tuple, intersecting_faces(folded).tolist())) == set(map(tuple, whole.tolist()))


def test_a_large_mesh_is_checked_in_seconds() -> None:
    large = mesh_of(trimesh.creation.icosphere(subdivisions=6, radius=5.0))
    started = time.process_time()
    assert not len(intersecting_faces(large))
    assert time.process_time() - started < 5  # 0.6 s for 82k faces on a quiet core
