"""The forward model against quadrature, and its pair and its filter against what defines them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from planning.projections.parts import small_goal, star
from vialight.core.arrays import Float32Array, Grid
from vialight.planning.projections import dose_of, light_for
from vialight.planning.projections.forward import collect, filtered_projections, strip_positions

GRID = Grid((6, 24, 24), 0.2, 4.0)


def inner(a: Float32Array, b: Float32Array) -> float:
    return float(np.vdot(a.astype(np.float64), b.astype(np.float64)))


@settings(max_examples=20, deadline=None)
@given(
    st.booleans(), st.sampled_from([0.0, 0.08]), st.sampled_from([0.0, 0.3]), st.sampled_from([0.0, 0.25]),
    st.sampled_from([None, 0.01]), st.integers(1, 3), st.integers(0, 2**32 - 1),
)  # fmt: skip
def test_collecting_is_the_transpose_of_exposing(
    climbing: bool, absorption: float, blur: float, diffusion: float, tilt: float | None, held: int, seed: int
) -> None:
    """<A x, y> = <x, A' y> to 1e-5: with absorption, tilt, both sides, blur, diffusion and held patterns."""
    rng = np.random.default_rng(seed)
    light = light_for(
        GRID, 12, absorption_per_mm=absorption, tilt_at=None if tilt is None else np.full(24, tilt), climbing=climbing,
        projector_blur_mm=blur, diffusion_mm=diffusion, held=held,
    )  # fmt: skip
    projections = rng.normal(size=(6, 24, 6)).astype(np.float32)
    volume = rng.normal(size=(24, 24, 6)).astype(np.float32)
    dose = dose_of(projections, light)
    bound = np.sqrt(inner(dose, dose) * inner(volume, volume))
    assert abs(inner(dose, volume) - inner(projections, collect(volume, light))) < 1e-5 * bound


@pytest.mark.parametrize("absorption", [0.0, 0.08, 0.3])
def test_dose_of_a_uniform_disk_is_that_of_quadrature(absorption: float) -> None:
    """Light of a disk's silhouette from all sides brings ``int exp(-mu r cos a) da`` where r < R; measured: 0.01 %."""
    grid = Grid((1, 60, 60), 0.1)
    light = light_for(grid, 180, absorption_per_mm=absorption)
    dose = dose_of(np.full((90, 60, 1), 1 / (2 * np.pi), np.float32), light)[:, :, 0]
    r = np.hypot(grid.x_mm, grid.y_mm[:, None])
    radii = np.linspace(0, 3, 31)
    expected = [quad(lambda a, r=r: np.exp(-absorption * r * np.cos(a)) / np.pi, 0, np.pi)[0] for r in radii]
    inside = r < 2.9
    np.testing.assert_allclose(dose[inside], np.interp(r[inside], radii, expected), rtol=2e-3)


def test_a_disk_of_light_brings_what_passes_beyond_it_only_from_the_angles_that_see_it() -> None:
    """Strips up to R from all sides: beyond it a voxel is lit for ``2 asin(R / r) / pi`` of the turn."""
    grid = Grid((1, 80, 80), 0.1)
    light = light_for(grid, 360)
    projections = np.zeros((180, 80, 1), np.float32)
    projections[:, 20:60] = 1 / (2 * np.pi)  # |s| < 2 mm
    dose = dose_of(projections, light)[:, :, 0]
    r = np.hypot(grid.x_mm, grid.y_mm[:, None])
    beyond = (r > 2.3) & (r < 3.9)
    expected = 2 * np.arcsin(2 / r[beyond]) / np.pi
    assert np.abs(dose[beyond] / expected - 1).max() < 0.02
    np.testing.assert_allclose(dose[r < 1.8], 1, rtol=1e-5)


def test_unclipped_filtered_projections_bring_the_target_back() -> None:
    """D = I: of the star 9.4 % RMS at 0.2 mm, all of it at edges, which strips blunt; of a bump without edges 0.4 %."""
    goal, light, grid = small_goal()
    dose = dose_of(filtered_projections(goal.inside, light), light)
    judged = np.broadcast_to(light.reach > 0, dose.shape)
    assert np.sqrt(np.mean((dose - goal.inside)[judged] ** 2)) < 0.1
    r2 = (grid.x_mm - 0.8) ** 2 + (grid.y_mm[:, None] + 0.5) ** 2
    bump = np.repeat(np.exp(-r2 / 2)[:, :, None], 2, axis=2).astype(np.float32)
    found = dose_of(filtered_projections(bump, light), light)
    assert np.sqrt(np.mean((found - bump)[judged] ** 2)) < 0.006


def test_a_uniform_target_asks_for_uniform_light_of_one_turns_share() -> None:
    """Of a wide disk of 1, the middle's projections come near ``1 / 2 pi``: the scale of the clip level."""
    grid = Grid((1, 300, 300), 0.1)
    light = light_for(grid, 8)
    inside = (np.hypot(grid.x_mm, grid.y_mm[:, None]) < 14.5).astype(np.float32)[:, :, None]
    filtered = filtered_projections(inside, light)[:, 100:200, 0]  # the steps of its edge ring at single angles
    assert 2 * np.pi * filtered.mean() == pytest.approx(1, abs=0.01)


def test_filtered_projections_know_nothing_of_absorption() -> None:
    goal, light, _ = small_goal()
    absorbing = replace(light, geometry=replace(light.geometry, absorption_per_mm=0.2))
    np.testing.assert_array_equal(
        filtered_projections(goal.inside, absorbing), filtered_projections(goal.inside, light)
    )


@pytest.mark.parametrize("climbing", [False, True])
def test_half_a_turn_from_both_sides_is_a_full_turn(climbing: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With absorption, spread and climb; between knots close enough that light of noise is alike to 1e-3."""
    monkeypatch.setattr("vialight.planning.strips._CLIMB_A_KNOT", 0.03)
    grid = Grid((8, 30, 30), 0.2, 6.0)
    rng = np.random.default_rng(1)
    tilt = 0.006 + 1e-5 * np.square(np.arange(30) - 14.5)
    half = light_for(grid, 20, absorption_per_mm=0.08, tilt_at=tilt, climbing=climbing)
    light = rng.random((10, 30, 8), np.float32)
    ways = [
        dose_of(shown, replace(half, geometry=replace(half.geometry, psi_rad=psi, from_both_sides=False)))
        for shown, psi in (
            (light, half.geometry.psi_rad),
            (np.ascontiguousarray(light[:, ::-1]), half.geometry.psi_rad + np.pi),
        )
    ]
    # A projection then stands for a whole step of the turn, one way.
    np.testing.assert_allclose((ways[0] + ways[1]) / 2, dose_of(light, half), rtol=1e-3)


@pytest.mark.parametrize("climbing", [False, True])
def test_a_held_projection_is_the_mean_of_flashes_about_its_angle(climbing: bool) -> None:
    """Of three, at the thirds of its share of the turn; and the same flashes see what it collects."""
    held = light_for(GRID, 12, absorption_per_mm=0.08, tilt_at=np.full(24, 0.01), climbing=climbing, held=3)
    third = np.pi / 6 / 3
    flashes = [
        replace(held, held=1, geometry=replace(held.geometry, psi_rad=held.geometry.psi_rad + turned))
        for turned in (-third, 0.0, third)
    ]
    rng = np.random.default_rng(2)
    projections = rng.random((6, 24, 6), np.float32)
    volume = rng.random((24, 24, 6), np.float32)
    for act, on in ((dose_of, projections), (collect, volume), (filtered_projections, volume)):
        mean = np.mean([act(on, flash) for flash in flashes], axis=0)
        np.testing.assert_allclose(act(on, held), mean, atol=2e-6 * np.abs(mean).max())


def test_blur_and_diffusion_spread_dose_by_their_variance() -> None:
    """One strip in one slice, blurred: its dose across at psi = 0 has the variance of strip and blur."""
    grid = Grid((41, 61, 61), 0.1)
    for blur, diffusion in ((0.25, 0.0), (0.0, 0.25), (0.2, 0.15)):
        light = light_for(grid, 2, radius_mm=3.05, projector_blur_mm=blur, diffusion_mm=diffusion)
        shown = np.zeros((1, light.geometry.samples, 41), np.float32)
        shown[0, light.geometry.samples // 2, 20] = 1
        dose = dose_of(shown, light)[30].astype(np.float64)  # (x, z), in the middle of y
        for axis, positions, extra in ((0, grid.x_mm, 0.1**2 / 12 * 2), (1, grid.z_mm, 0.0)):
            profile = dose.sum(axis=1 - axis) / dose.sum()
            middle = (profile * positions).sum()
            variance = (profile * (positions - middle) ** 2).sum()
            # A strip of 0.1 mm over voxels of 0.1 mm adds their widths' variance across.
            assert variance == pytest.approx(0.25**2 + extra, rel=0.03)


def test_every_voxel_within_reach_lies_under_strips_at_every_angle() -> None:
    light = light_for(GRID, 36)
    seen = dose_of(np.ones((18, 24, 6), np.float32), light) / (2 * np.pi)
    np.testing.assert_allclose(seen[light.reach[:, :, 0] > 0], 1, rtol=1e-5)


def test_strips_cover_a_circle_and_begin_evenly_about_the_axis() -> None:
    positions = strip_positions(1.01, 0.2)
    assert positions[0] == -positions[-1]
    assert positions[-1] + 0.1 >= 1.01
    assert len(strip_positions(1.0, 0.25)) == 8


def test_the_star_is_what_is_said_of_it() -> None:
    grid = Grid((5, 46, 46), 0.2)
    inside = star(grid, 1)
    assert not inside[:, :, [0, -1]].any()
    assert inside[:, :, 1:-1].mean() == pytest.approx((np.pi * (3.2**2 + 0.8**2 / 2 - 0.64)) / 9.2**2, rel=0.02)
