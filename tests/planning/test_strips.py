"""Strips of light against areas, chords and the transpose worked out by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vialight.core.arrays import Float32Array, FloatArray, centred
from vialight.planning.strips import StripGeometry, backproject_strips, project_strips


def geometry(
    angles: FloatArray | list[float], samples: int = 40, width: float = 0.2, across: int = 30, voxel: float = 0.2
) -> StripGeometry:
    pixels = centred(across, voxel)
    return StripGeometry(
        np.asarray(angles, np.float64), float(centred(samples, width)[0]), width, samples, pixels, pixels
    )


def inner(a: Float32Array, b: Float32Array) -> float:
    return float(np.vdot(a.astype(np.float64), b.astype(np.float64)))


def disk(layout: StripGeometry, x: float, y: float, radius: float, subs: int = 8) -> Float32Array:
    """Share of each voxel inside a disk, (y, x, 1)."""
    shift = centred(subs, layout.voxel_mm / subs)
    fine_x, fine_y = ((axis[:, None] + shift).ravel() for axis in (layout.x_mm, layout.y_mm))
    inside = np.hypot(fine_x - x, fine_y[:, None] - y) < radius
    shape = (len(layout.y_mm), subs, len(layout.x_mm), subs)
    share: Float32Array = inside.reshape(shape).mean(axis=(1, 3))[:, :, None].astype(np.float32)
    return share


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0, 0.1), st.sampled_from([None, 0.0, 0.02]), st.sampled_from(["plain", "both", "climbing"]),
    st.floats(0.75, 2), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_projection_is_the_transpose_of_backprojection(
    absorption: float, tilt: float | None, kind: str, width: float, seed: int
) -> None:
    """<A x, y> = <x, A' y> to 1e-5 of what both could be at most."""
    rng = np.random.default_rng(seed)
    depth = 5
    layout = replace(
        geometry(rng.uniform(0, 7, 7), samples=17, width=0.3 * width, across=13, voxel=0.3),
        absorption_per_mm=absorption,
        tilt_per_mm=None if tilt is None else np.full(17, tilt),
        z_mm=3 + centred(depth, 0.3) if kind == "climbing" else None,
        from_both_sides=kind == "both",
    )
    light = rng.normal(size=(7, 17, depth)).astype(np.float32)
    volume = rng.normal(size=(13, 13, depth)).astype(np.float32)
    dose, seen = backproject_strips(light, layout), project_strips(volume, layout)
    bound = np.sqrt(inner(dose, dose) * inner(volume, volume))
    assert abs(inner(seen, light) - inner(volume, dose)) < 1e-5 * bound


def test_a_strip_lights_each_voxel_by_the_share_of_it_that_it_covers() -> None:
    """At psi = 0 strip i spans s = x: here 0.13 to 0.38 mm over voxels of 0.2 mm."""
    layout = replace(geometry([0.0], samples=1, width=0.25, across=6), first_s_mm=0.255)
    dose = backproject_strips(np.ones((1, 1, 1), np.float32), layout)[:, :, 0]
    edges = np.arange(-3, 4) * 0.2
    covered = np.clip(np.minimum(edges[1:], 0.38) - np.maximum(edges[:-1], 0.13), 0, None) / 0.2
    np.testing.assert_allclose(dose, np.tile(covered, (6, 1)), atol=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.3, np.pi / 4, np.pi / 2, 2.5, -1.0])
def test_strips_side_by_side_light_all_of_every_voxel_at_any_angle(angle: float) -> None:
    layout = geometry([angle], samples=70, width=0.15)
    lit = backproject_strips(np.ones((1, 70, 2), np.float32), layout)
    np.testing.assert_allclose(lit, 1, atol=1e-6)


@pytest.mark.parametrize("angle", [0.2, np.pi / 4, 1.3, 4.0])
def test_a_slanting_strip_covers_the_area_that_counting_points_finds(angle: float) -> None:
    layout = replace(geometry([angle], samples=1, width=0.17, across=8), first_s_mm=0.23)
    fine = centred(8 * 200, 0.2 / 200)
    inside = np.abs(fine * np.cos(angle) - fine[:, None] * np.sin(angle) - 0.23) < 0.085
    share = inside.reshape(8, 200, 8, 200).mean(axis=(1, 3))
    dose = backproject_strips(np.ones((1, 1, 1), np.float32), layout)[:, :, 0]
    np.testing.assert_allclose(dose, share, atol=5e-3)


@pytest.mark.parametrize(("x", "y"), [(0.0, 0.0), (1.1, -0.7), (-0.4, 1.5)])
def test_the_sinogram_of_a_disk_is_its_chord(x: float, y: float) -> None:
    """A disk of radius R at (x, y) has ``p = 2 sqrt(R^2 - (s - x cos psi + y sin psi)^2)`` mm, averaged over a strip.

    The RMS error is 0.012 mm at 0.1 mm voxels, for chords of up to 2.6 mm: voxels blunt the edge.  Away from it, it is
    0.004 mm, and areas are true to 1e-3.
    """
    radius, psi = 1.3, np.arange(24, dtype=np.float64) * (2 * np.pi / 24)
    layout = geometry(psi, samples=70, width=0.1, across=64, voxel=0.1)
    found = project_strips(disk(layout, x, y, radius), layout)[:, :, 0] * 0.1
    middle = x * np.cos(psi) - y * np.sin(psi)
    edge = np.clip((centred(71, 0.1) - middle[:, None]) / radius, -1, 1)
    area = radius**2 * (edge * np.sqrt(1 - edge**2) + np.arcsin(edge))  # of what lies below s
    expected = np.diff(area, axis=1) / 0.1
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.014
    within = np.abs(centred(70, 0.1) - middle[:, None]) < radius - 0.25
    assert np.sqrt(np.mean((found - expected)[within] ** 2)) < 0.01
    np.testing.assert_allclose(found.sum(axis=1) * 0.1, np.pi * radius**2, rtol=2e-3)


def test_absorbed_light_falls_exponentially_along_its_way() -> None:
    """At psi = 0 light runs along +y, at psi = pi/2 along +x; t = 0 is where it passes the axis."""
    layout = replace(geometry([0.0, np.pi / 2]), absorption_per_mm=0.3)
    for light, along in ((0, layout.y_mm[:, None]), (1, layout.x_mm)):
        shown = np.zeros((2, 40, 1), np.float32)
        shown[light] = 1
        lit = backproject_strips(shown, layout)[:, :, 0]
        np.testing.assert_allclose(lit, np.broadcast_to(np.exp(-0.3 * along), lit.shape), rtol=1e-5)


def test_light_from_both_sides_is_the_mean_of_light_from_each() -> None:
    rng = np.random.default_rng(1)
    psi = np.arange(5, dtype=np.float64) * (np.pi / 5)
    one_way = replace(
        geometry(psi), absorption_per_mm=0.1, tilt_per_mm=0.01 + 1e-4 * np.arange(40, dtype=np.float64) ** 2
    )
    # Tilts are even in s, as the vial is.
    assert one_way.tilt_per_mm is not None
    even = (one_way.tilt_per_mm + one_way.tilt_per_mm[::-1]) / 2
    one_way = replace(one_way, tilt_per_mm=even)
    light = rng.random((5, 40, 3), np.float32)
    there = backproject_strips(light, one_way)
    back = backproject_strips(np.ascontiguousarray(light[:, ::-1]), replace(one_way, psi_rad=psi + np.pi))
    both = backproject_strips(light, replace(one_way, from_both_sides=True))
    np.testing.assert_allclose(both, (there + back) / 2, rtol=2e-4, atol=2e-5)


@pytest.fixture
def close_knots(monkeypatch: pytest.MonkeyPatch) -> None:
    """Find what light becomes along its way at so many places that what lies between does not matter."""
    monkeypatch.setattr("vialight.planning.strips._CLIMB_A_KNOT", 0.03)
    monkeypatch.setattr("vialight.planning.strips._ABSORPTION_A_KNOT", 0.01)


@pytest.mark.usefixtures("close_knots")
def test_light_that_climbs_comes_from_the_height_it_had_at_the_axis() -> None:
    """A ray of mid-height z runs at ``z (1 + t tilt)``: light in proportion to mid-height falls by that squared."""
    heights = 8 + centred(30, 0.1)
    layout = replace(geometry([0.0]), tilt_per_mm=np.full(40, 0.01), z_mm=heights)
    light = np.broadcast_to(heights.astype(np.float32), (1, 40, 30))
    lit = backproject_strips(light, layout)
    spread = 1 + 0.01 * layout.y_mm[:, None, None]
    middle = slice(6, -6)  # the ends are continued with the outermost slice
    np.testing.assert_allclose(
        lit[:, :, middle], np.broadcast_to(heights / spread**2, lit.shape)[:, :, middle], rtol=1e-5
    )


def test_light_that_does_not_climb_stays_in_its_slice() -> None:
    rng = np.random.default_rng(2)
    layout = replace(geometry(rng.uniform(0, 7, 6)), absorption_per_mm=0.1)
    light = rng.random((6, 40, 4), np.float32)
    flat = replace(layout, tilt_per_mm=np.zeros(40), z_mm=5 + centred(4, 0.2))
    np.testing.assert_allclose(backproject_strips(light, flat), backproject_strips(light, layout), rtol=1e-4, atol=1e-5)


def test_spreading_light_weakens_in_its_slice() -> None:
    layout = replace(geometry([0.0]), tilt_per_mm=np.full(40, 0.02))
    lit = backproject_strips(np.ones((1, 40, 1), np.float32), layout)[:, :, 0]
    np.testing.assert_allclose(lit, np.broadcast_to(1 / (1 + 0.02 * layout.y_mm[:, None]), lit.shape), rtol=1e-5)


def test_what_lies_outside_the_strips_is_dark() -> None:
    layout = geometry([0.0], samples=4, width=0.2, across=10)
    lit = backproject_strips(np.ones((1, 4, 1), np.float32), layout)[0, :, 0]
    np.testing.assert_allclose(lit, [0, 0, 0, 1, 1, 1, 1, 0, 0, 0], atol=1e-6)


@pytest.mark.usefixtures("close_knots")
@pytest.mark.parametrize(("tilt", "exactness"), [(None, 1e-5), (np.full(60, 0.01), 3e-3)], ids=["level", "climbing"])
def test_the_dose_of_a_wide_voxel_is_the_mean_over_what_it_is_made_of(
    tilt: FloatArray | None, exactness: float
) -> None:
    """Voxels three strips wide against nine as wide as one: alike, but for the 0.3 % that light spreads in them."""
    rng = np.random.default_rng(3)
    psi = rng.uniform(0, 7, 9)
    fine, wide = (
        replace(
            geometry(psi, samples=60, width=0.1, across=across, voxel=voxel), tilt_per_mm=tilt,
            z_mm=None if tilt is None else 4 + centred(6, 0.3),
        )
        for across, voxel in ((36, 0.1), (12, 0.3))
    )  # fmt: skip
    light = rng.random((9, 60, 6), np.float32)
    expected = backproject_strips(light, fine).reshape(12, 3, 12, 3, 6).mean(axis=(1, 3))
    np.testing.assert_allclose(backproject_strips(light, wide), expected, rtol=exactness)


def test_voxels_that_are_too_wide_are_refused() -> None:
    with pytest.raises(ValueError, match="too wide"):
        geometry([0.0], width=0.2, voxel=0.8)
    wide = geometry([0.0], width=0.1, across=8, voxel=0.3)
    with pytest.raises(ValueError, match="only backprojected"):
        project_strips(np.ones((8, 8, 1), np.float32), wide)


@pytest.mark.usefixtures("close_knots")
@pytest.mark.parametrize("climbing", [False, True])
@pytest.mark.parametrize("absorption", [0.0, 0.08])
def test_a_full_turn_is_what_its_halves_bring(climbing: bool, absorption: float) -> None:
    """Light that differs by its way, summed at once, is the sum of both ways; noise curves by 2 between two knots."""
    rng = np.random.default_rng(4)
    psi = np.arange(12, dtype=np.float64) * (np.pi / 6)
    tilt = 0.004 + 1e-5 * np.square(np.arange(40) - 19.5)
    layout = replace(
        geometry(psi), absorption_per_mm=absorption, tilt_per_mm=tilt, z_mm=5 + centred(8, 0.2) if climbing else None
    )
    light = rng.random((12, 40, 8), np.float32)
    halves = sum(backproject_strips(light[part], replace(layout, psi_rad=psi[part])) for part in (np.s_[:6], np.s_[6:]))
    np.testing.assert_allclose(backproject_strips(light, layout), halves, rtol=1e-3)


def test_shadows_on_the_edge_of_a_strip_are_the_same_both_ways() -> None:
    """At multiples of 15 degrees, strips as wide as voxels: voxel by voxel and strip by strip."""
    layout = geometry(np.arange(24, dtype=np.float64) * (np.pi / 12), samples=14, across=10)
    voxels = np.eye(100, dtype=np.float32).reshape(10, 10, 100)
    shares = project_strips(voxels, layout)
    for angle in range(24):
        alone = replace(layout, psi_rad=layout.psi_rad[angle : angle + 1])
        lit = backproject_strips(np.eye(14, dtype=np.float32)[None], alone)
        np.testing.assert_allclose(shares[angle].T.reshape(10, 10, 14), lit, atol=2e-6)
