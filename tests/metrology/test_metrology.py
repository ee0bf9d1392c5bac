"""Metrology against bodies whose distances, symmetries and diameters are known."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from vialight.core.errors import InputError, VialightWarning
from vialight.core.mesh import Mesh
from vialight.metrology import (
    compare,
    intersection_over_union,
    measure_cylinders,
    register,
    sample_surface,
    signed_distance,
    unsigned_distance,
)
from vialight.metrology.distance import Deviation, deviation
from vialight.metrology.rigid import displacement_metric, flow_of, step_of
from vialight.metrology.round_faces import cylindrical_faces


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def joined(*meshes: Mesh) -> Mesh:
    """Lay bodies that do not touch into one mesh."""
    offsets = np.cumsum([0, *(len(mesh.vertices_mm) for mesh in meshes[:-1])])
    faces = [mesh.faces + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(np.vstack([mesh.vertices_mm for mesh in meshes]), np.vstack(faces))


def box(*sides_mm: float) -> Mesh:
    return mesh_of(trimesh.creation.box(sides_mm))


def sphere(radius_mm: float, subdivisions: int = 4) -> Mesh:
    return mesh_of(trimesh.creation.icosphere(subdivisions=subdivisions, radius=radius_mm))


def cylinder(radius_mm: float, height_mm: float, sections: int = 96) -> Mesh:
    return mesh_of(trimesh.creation.cylinder(radius_mm, height_mm, sections=sections))


def motion(axis: ArrayLike, angle_deg: float, shift_mm: ArrayLike) -> np.ndarray:
    matrix = np.eye(4)
    unit = np.asarray(axis) / np.linalg.norm(axis)
    matrix[:3, :3] = Rotation.from_rotvec(np.radians(angle_deg) * unit).as_matrix()
    matrix[:3, 3] = shift_mm
    return matrix


def shifted(mesh: Mesh, *shift_mm: float) -> Mesh:
    return Mesh(mesh.vertices_mm + shift_mm, mesh.faces)


# An asymmetric part of the size of a print: a plate, and three rods of different kinds beside it.
PART = joined(
    box(9, 5, 2),
    shifted(cylinder(1.2, 4), 2.5, 0.7, 3.2),
    shifted(box(1, 2, 3), -3, 1, 3),
    shifted(box(2, 1, 1), -1, -3.5, 0),
)

directions = st.tuples(*[st.floats(-1, 1)] * 3).filter(lambda axis: np.linalg.norm(axis) > 0.1)
shifts = st.tuples(*[st.floats(-20, 20)] * 3)


def test_distance_is_negative_inside_and_positive_outside() -> None:
    block = box(2, 4, 6)
    points = np.array([[0, 0, 0], [0.9, 0, 0], [3, 0, 0], [4, 5, 0], [2, 3, 4]])
    np.testing.assert_allclose(signed_distance(points, block), [-1, -0.1, 2, np.hypot(3, 3), np.sqrt(3)])
    np.testing.assert_allclose(unsigned_distance(points, block), [1, 0.1, 2, np.hypot(3, 3), np.sqrt(3)])


def test_sign_is_right_next_to_a_concave_edge() -> None:
    outline = [(0, 0), (2, 0), (2, 1), (1, 1), (1, 2), (0, 2)]
    lid = np.array([(0, 1, 2), (0, 2, 3), (0, 3, 4), (0, 4, 5)])
    walls = [quad for k in range(6) for n in [(k + 1) % 6] for quad in ((k, n, n + 6), (k, n + 6, k + 6))]
    corners = [(x, y, z) for z in (-5, 5) for x, y in outline]
    angle = Mesh(np.array(corners, dtype=float), np.vstack([lid[:, ::-1], lid + 6, walls]))
    points = [[1.1, 1.2, 0], [0.9, 0.8, 0], [1.0001, 0.9999, 0], [1.0001, 1.0002, 0]]
    np.testing.assert_allclose(signed_distance(points, angle), [0.1, -np.hypot(0.1, 0.2), -0.0001, 0.0001], atol=1e-9)


def test_faces_without_area_leave_every_distance_finite() -> None:
    block = box(2, 4, 6)
    middle = block.vertices_mm[block.faces[0, :2]].mean(axis=0)
    sliver = [*block.faces[0, :2], len(block.vertices_mm)]
    dirty = Mesh(np.vstack([block.vertices_mm, middle]), np.vstack([block.faces, [sliver], [sliver[::-1]]]))
    points = np.random.default_rng(0).uniform(-4, 4, (200, 3))
    np.testing.assert_allclose(signed_distance(points, dirty), signed_distance(points, block))


def test_open_mesh_is_measured_without_sign_and_with_a_warning() -> None:
    block = box(2, 4, 6)
    with pytest.warns(VialightWarning, match="not watertight"):
        assert signed_distance([[0, 0, 0]], Mesh(block.vertices_mm, block.faces[:-1])) >= 0
    with pytest.warns(VialightWarning, match="inside out"):
        assert signed_distance([[0, 0, 0]], Mesh(block.vertices_mm, block.faces[:, ::-1])) == pytest.approx(1)


def test_samples_weigh_every_part_of_the_surface_by_its_area() -> None:
    block = box(2, 4, 6)
    coarse, fine = (
        sample_surface(block),
        sample_surface(mesh_of(trimesh.creation.box((2, 4, 6)).subdivide().subdivide())),
    )
    for samples in (coarse, fine):
        assert samples.weights_mm2.sum() == pytest.approx(88)
        on_top = samples.points_mm[:, 2] > 3 - 1e-9
        assert samples.weights_mm2[on_top].sum() == pytest.approx(8, rel=1e-3)
        second_moment = np.average(samples.points_mm[:, 0] ** 2, weights=samples.weights_mm2)
        # By hand: two sides at |x| = 1 of 24 mm^2; the other 40 mm^2 have x uniform on -1..1.
        assert second_moment == pytest.approx((48 + 40 / 3) / 88, rel=2e-3)


def test_statistics_are_those_of_the_area() -> None:
    part = Deviation(np.array([-1.0, 2.0, 5.0]), np.array([3.0, 1.0, 0.0]), is_signed=True, worst_point_mm=np.zeros(3))
    assert part.rmse_mm == pytest.approx(np.sqrt(7 / 4))
    assert part.mean_mm == pytest.approx(-0.25)
    assert part.std_mm == pytest.approx(np.sqrt(7 / 4 - 1 / 16))
    assert (part.p95_mm, part.max_mm) == (2.0, 5.0)
    assert part.share_within(1.5) == pytest.approx(0.75)


@pytest.mark.parametrize("offset_mm", [0.2, -0.3])
def test_concentric_spheres_give_the_offset(offset_mm: float) -> None:
    result = compare(sphere(5 + offset_mm, 5), sphere(5, 5), align="none").as_placed
    sag = 5 * (1 - np.cos(0.02))  # facets of 0.04 rad
    for part, sign in ((result.forward, 1), (result.reverse, -1)):
        assert part.mean_mm == pytest.approx(sign * offset_mm, abs=sag)
        assert part.rmse_mm == pytest.approx(abs(offset_mm), abs=sag)
        assert part.std_mm == pytest.approx(0, abs=sag)
        assert part.p95_mm == pytest.approx(abs(offset_mm), abs=sag)
    assert result.hausdorff_mm == pytest.approx(abs(offset_mm), abs=sag)
    ratio = (1 + offset_mm / 5) ** 3
    assert result.volume_error_percent == pytest.approx(100 * (ratio - 1), abs=1e-6)
    assert result.iou == pytest.approx(min(ratio, 1 / ratio), rel=1e-3)


@settings(max_examples=6, deadline=None)
@given(axis=directions, angle=st.floats(0, 180), shift=shifts)
def test_a_rigid_motion_of_both_leaves_metrology_unchanged(
    axis: tuple[float, float, float], angle: float, shift: tuple[float, float, float]
) -> None:
    print_mesh = shifted(joined(box(9.2, 5, 2.1), shifted(sphere(1.2, 2), 2.5, 0, 3.2)), 0.05, -0.1, 0.02)
    both = motion(axis, angle, shift)
    before = compare(print_mesh, PART, align="none").as_placed
    after = compare(print_mesh.moved(both), PART.moved(both), align="none").as_placed
    values = before.to_json()
    for name, value in after.to_json().items():
        if name in ("iou", "rmse_percent", "std_percent", "hausdorff_on", "hausdorff_at_mm"):
            continue  # cut along z; relative to a box along the axes; one of many places where it is as far
        assert value == pytest.approx(values[name], rel=1e-6, abs=1e-9), name
    assert after.iou == pytest.approx(before.iou, abs=2e-3)


@settings(max_examples=8, deadline=None)
@given(st.floats(0.5, 20), st.floats(0.5, 20), st.floats(0.5, 20), directions, st.floats(0, 180), shifts)
def test_a_mesh_is_no_distance_from_itself(
    x: float, y: float, z: float, axis: tuple[float, float, float], angle: float, shift: tuple[float, float, float]
) -> None:
    block = box(x, y, z).moved(motion(axis, angle, shift))
    result = compare(block, block, align="none").as_placed
    assert result.hausdorff_mm < 1e-10
    assert result.iou == pytest.approx(1, abs=1e-12)
    assert result.volume_error_percent == 0


def test_a_missing_half_is_seen_in_reverse_and_by_hausdorff_not_by_the_prints_rmse() -> None:
    whole, half = box(8, 4, 4), shifted(box(4, 4, 4), -2, 0, 0)
    result = compare(half, whole, align="none", tolerance_mm=0.5)
    assert result.as_placed.hausdorff_mm == pytest.approx(4)
    body, point = result.as_placed.worst
    assert body == "reference"
    assert point[0] == pytest.approx(4)
    assert result.as_placed.reverse.rmse_mm > 1.5
    assert result.as_placed.iou == pytest.approx(0.5)
    assert result.as_placed.volume_error_percent == pytest.approx(-50)
    assert result.tolerance is not None
    assert not result.tolerance.passed
    assert result.tolerance.reverse_share_within < 0.6


@pytest.mark.parametrize(("tolerance_mm", "passes"), [(0.11, True), (0.09, False)])
def test_tolerance_is_kept_where_all_of_the_surface_is_within(tolerance_mm: float, passes: bool) -> None:
    result = compare(sphere(5.1), sphere(5), align="none", tolerance_mm=tolerance_mm).tolerance
    assert result is not None
    assert result.passed is passes
    assert result.share_within == (1.0 if passes else 0.0)


def test_a_missing_pin_fails_a_tolerance_that_the_95th_percentile_keeps() -> None:
    plate = box(10, 10, 2)
    with_pin = joined(plate, shifted(box(0.5, 0.5, 2), 0, 0, 2.1))
    result = compare(plate, with_pin, align="none", tolerance_mm=0.2)
    assert result.as_placed.forward.p95_mm < 0.2
    assert result.as_placed.reverse.p95_mm < 0.2
    assert result.tolerance is not None
    assert not result.tolerance.passed


def test_open_reference_leaves_out_what_needs_an_inside() -> None:
    block = box(4, 5, 6)
    lid_off = Mesh(block.vertices_mm, block.faces[:-1])
    with pytest.warns(VialightWarning, match="the reference is not watertight"):
        result = compare(shifted(block, 0.1, 0, 0), lid_off, align="none").as_placed.to_json()
    assert result["mean_mm"] is result["std_mm"] is result["std_percent"] is None
    assert result["iou"] is result["volume_error_percent"] is None
    assert result["rmse_mm"] is not None
    assert result["rmse_mm"] > 0
    assert result["reverse_mean_mm"] is not None


def test_fifty_random_starts_end_in_the_same_place() -> None:
    rng = np.random.default_rng(2)
    for _ in range(50):
        axis, shift = rng.normal(size=3), rng.normal(size=3)
        moved = motion(axis, 30 * np.sqrt(rng.uniform()), 3 * np.sqrt(rng.uniform()) * shift / np.linalg.norm(shift))
        found = register(PART.moved(moved), PART)
        left = PART.moved(found.matrix @ moved).vertices_mm - PART.vertices_mm
        assert np.abs(left).max() < 1e-5
        assert found.open_directions == ()


def test_a_worn_print_is_laid_where_its_rmse_is_least() -> None:
    rng = np.random.default_rng(4)
    base = mesh_of(trimesh.creation.box((9, 5, 2)).subdivide().subdivide().subdivide())
    worn = Mesh(base.vertices_mm + rng.normal(0, 0.05, base.vertices_mm.shape), base.faces)
    moved = worn.moved(motion((1, 2, -1), 25, (1, -2, 1.5)))

    def rmse(transform: np.ndarray) -> float:
        return deviation(sample_surface(moved.moved(transform), 20_000), box(9, 5, 2)).rmse_mm

    found = register(moved, box(9, 5, 2)).matrix
    for twist in np.vstack([np.eye(6), -np.eye(6)]) * np.repeat([0.002, 0.01], 3):
        assert rmse(step_of(twist, np.zeros(3)) @ found) > rmse(found)


TILT = motion((1, 0.5, 0), 12, (0.6, -0.4, 1.0))
SYMMETRIC: dict[str, tuple[Mesh, tuple[str, ...]]] = {
    "cylinder": (cylinder(3, 8), ("rotation about z",)),
    "sphere": (sphere(3), ("rotation about x", "rotation about y", "rotation about z")),
    "torus": (mesh_of(trimesh.creation.torus(4, 1)), ("rotation about z",)),
    "lying cylinder": (
        cylinder(1, 8).moved(motion((0, 1, 0), 90, (0, 2, 1))),
        ("rotation about x through (0.00, 2.00, 1.00) mm",),
    ),
    "square rod": (box(1, 1, 30), ()),
    "hexagonal prism": (cylinder(3, 8, sections=6), ()),
}


@pytest.mark.parametrize("name", SYMMETRIC)
def test_what_symmetry_leaves_open_is_named_and_left_alone(name: str) -> None:
    mesh, expected = SYMMETRIC[name]
    found = register(mesh.moved(TILT), mesh)
    assert found.open_directions == expected
    combined = found.matrix @ TILT
    assert unsigned_distance(mesh.vertices_mm @ combined[:3, :3].T + combined[:3, 3], mesh).max() < 0.01


def test_nothing_is_turned_about_an_open_axis() -> None:
    upright = cylinder(3, 8)
    spun = register(upright.moved(motion((0, 0, 1), 20, (1, 2, 0.5))), upright)
    assert spun.angle_deg == pytest.approx(0, abs=1e-3)
    np.testing.assert_allclose(spun.translation_mm, [-1, -2, -0.5], atol=2e-3)
    ball = register(sphere(3).moved(TILT), sphere(3))
    assert ball.angle_deg == pytest.approx(0, abs=1e-3)


def test_registration_does_not_scale() -> None:
    found = register(sphere(3.5), sphere(3)).matrix
    np.testing.assert_allclose(found[:3, :3].T @ found[:3, :3], np.eye(3), atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-1, 1), min_size=6, max_size=6), st.integers(0, 99))
def test_displacement_metric_is_the_sum_of_squared_displacements(twist: list[float], seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(30, 3))
    t = np.array(twist)
    displacement = np.cross(t[:3], points) + t[3:]
    assert t @ displacement_metric(points) @ t == pytest.approx((displacement**2).sum(), abs=1e-12)
    for small in (step_of(t * 1e-6, np.zeros(3)), flow_of(t * 1e-6, np.zeros(3))):
        np.testing.assert_allclose(points @ small[:3, :3].T + small[:3, 3] - points, displacement * 1e-6, atol=1e-10)


def test_overlap_of_boxes_is_exact() -> None:
    shared = 1.5 * 3 * 4
    moved = shifted(box(2, 4, 5), 0.5, 1, 1)
    assert intersection_over_union(box(2, 4, 5), moved) == pytest.approx(shared / (80 - shared), rel=2e-3)


def test_bodies_that_overlap_themselves_count_once() -> None:
    twice = joined(box(2, 2, 2), shifted(box(2, 2, 2), 1, 0, 0))
    assert intersection_over_union(twice, box(3, 2, 2).moved(motion((0, 0, 1), 0, (0.5, 0, 0)))) == pytest.approx(1)


def test_cylinders_of_a_tube_are_found_and_told_apart() -> None:
    tube = mesh_of(trimesh.creation.annulus(1, 3, 8, sections=128)).moved(motion((1, 0.3, 0.5), 40, (3, 2, 1)))
    outer, inner = measure_cylinders(tube, tube)
    assert (outer.is_hole, inner.is_hole) == (False, True)
    for found, diameter in ((outer, 6), (inner, 2)):
        assert found.reference_diameter_mm == pytest.approx(diameter, rel=1e-6)
        assert found.diameter_mm == pytest.approx(diameter, rel=1e-3)  # chords, not arcs
        assert found.height_mm == pytest.approx(8)
        assert found.arc_deg == 360
        np.testing.assert_allclose(found.axis_point_mm, [3, 2, 1], atol=1e-6)
        np.testing.assert_allclose(np.abs(found.direction @ motion((1, 0.3, 0.5), 40, (0, 0, 0))[:3, 2]), 1, atol=1e-9)


def test_a_larger_tilted_print_tells_its_own_diameter() -> None:
    fine = trimesh.creation.cylinder(3.1, 8, sections=64).subdivide().subdivide().subdivide()
    radii = np.hypot(fine.vertices[:, 0], fine.vertices[:, 1])
    fine.vertices[radii > 3, :2] *= 3.1 / radii[radii > 3, None]
    tilted = mesh_of(fine).moved(motion((1, 1, 0), 2, (0.05, 0.03, 0)))
    (found,) = measure_cylinders(tilted, cylinder(3, 8))
    assert found.diameter_mm == pytest.approx(6.2, abs=1e-4)
    assert found.residual_rms_mm == pytest.approx(0, abs=1e-4)


def test_a_face_that_was_not_printed_has_no_diameter() -> None:
    reference = joined(box(4, 4, 4), shifted(cylinder(1, 5), 10, 0, 0))
    (found,) = measure_cylinders(box(4, 4, 4), reference)
    assert found.diameter_mm is None
    assert found.residual_rms_mm is None


@pytest.mark.parametrize(
    "shape",
    [sphere(3), box(3, 4, 5), cylinder(3, 8, sections=6), mesh_of(trimesh.creation.cone(3, 8, sections=64))],
    ids=["sphere", "box", "hexagon", "cone"],
)
def test_what_is_no_cylinder_is_not_called_one(shape: Mesh) -> None:
    assert cylindrical_faces(shape) == ()


def test_comparison_goes_into_json_under_the_documented_names() -> None:
    result = compare(shifted(PART, 0.3, 0, 0), PART, tolerance_mm=0.1)
    content = json.loads(json.dumps(result.to_json(), allow_nan=False))
    names = {"rmse_mm", "mean_mm", "std_mm", "p95_mm"}
    names |= {f"reverse_{name}" for name in names} | {"hausdorff_mm", "rmse_percent"}
    assert names <= content["as_placed"].keys()
    assert names <= content["aligned"].keys()
    assert {"max_dimension_mm", "iou", "volume_error_percent", "transform"} <= content.keys()
    np.testing.assert_allclose(np.array(content["transform"])[:3, 3], [-0.3, 0, 0], atol=1e-6)
    assert content["tolerance"]["passed"] is True
    assert content["as_placed"]["rmse_mm"] > 0.1 > content["aligned"]["rmse_mm"]
    assert content["as_placed"]["rmse_percent"] == pytest.approx(100 * content["as_placed"]["rmse_mm"] / 9)


def test_without_alignment_the_print_is_left_as_placed() -> None:
    result = compare(shifted(PART, 0.3, 0, 0), PART, align="none")
    assert result.aligned is None
    np.testing.assert_array_equal(result.transform, np.eye(4))
    assert result.to_json()["alignment"] == {"kind": "none"}
    assert len(result.deviation_mm) == len(PART.vertices_mm)
    assert result.deviation_mm.max() == pytest.approx(0.3)


@pytest.mark.parametrize("tolerance_mm", [0.0, -1.0, np.nan, np.inf])
def test_a_tolerance_that_is_no_length_is_refused(tolerance_mm: float) -> None:
    with pytest.raises(InputError, match="--tolerance"):
        compare(PART, PART, tolerance_mm=tolerance_mm)


def test_an_unknown_alignment_is_refused() -> None:
    with pytest.raises(InputError, match="rigid, none"):
        compare(PART, PART, align="scaled")  # type: ignore[arg-type]


def test_a_reference_in_another_unit_is_doubted_but_measured() -> None:
    in_um = Mesh(1000 * PART.vertices_mm, PART.faces)
    with pytest.warns(VialightWarning, match="the reference is 1e[+]03 times as large as the print: are both in mm?"):
        compare(PART, in_um, align="none")
