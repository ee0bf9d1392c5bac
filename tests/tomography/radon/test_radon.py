"""Ramp filters and backprojection against their definitions, in plain NumPy."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.core.arrays import Float32Array, FloatArray, centred
from vialight.core.errors import InputError
from vialight.tomography.radon import FilterName, backproject, backproject_tilted, filter_rays, ramp_filter

FILTERS: tuple[FilterName, ...] = get_args(FilterName)

WINDOWS = {
    "ram-lak": lambda f: np.ones_like(f),
    "shepp-logan": np.sinc,
    "cosine": lambda f: np.cos(np.pi * f),
    "hann": lambda f: np.cos(np.pi * f) ** 2,
}
"""What the ramp |f| is multiplied by, f in cycles a sample up to 1/2."""


def naive_backprojection(
    filtered: Float32Array, psi: FloatArray, s_mm: FloatArray, x_mm: FloatArray, y_mm: FloatArray
) -> FloatArray:
    x, y = np.meshgrid(x_mm, y_mm)
    total = np.zeros((len(y_mm), len(x_mm), filtered.shape[2]))
    for angle, view in zip(psi, filtered, strict=True):
        s = x * np.cos(angle) - y * np.sin(angle)
        for z in range(filtered.shape[2]):
            total[..., z] += np.interp(s, s_mm, view[:, z], left=0, right=0)
    return total


@pytest.mark.parametrize("name", FILTERS)
def test_filter_is_its_windowed_ramp_transformed_exactly(name: FilterName) -> None:
    count, spacing = 40, 0.25
    # Midpoints of |f| <= 1/2, fine enough for lags up to 39: the integral of |f| W(f) cos(2 pi f lag) df.
    f = (np.arange(200_000) + 0.5) / 400_000
    lags = np.arange(count)
    expected = [2 * np.mean(f * WINDOWS[name](f) * np.cos(2 * np.pi * f * lag)) / 2 for lag in lags]
    matrix = ramp_filter(name, count, spacing)
    np.testing.assert_allclose(matrix[0], np.array(expected) / spacing, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(matrix, matrix.T)
    assert all((np.diagonal(matrix, lag) == matrix[0, lag]).all() for lag in range(count))


def test_ram_lak_has_the_values_of_kak_and_slaney() -> None:
    row = ramp_filter("ram-lak", 6, 0.5)[0] * 0.5
    np.testing.assert_allclose(row, [1 / 4, -1 / np.pi**2, 0, -1 / (9 * np.pi**2), 0, -1 / (25 * np.pi**2)], atol=1e-8)


@pytest.mark.parametrize("name", FILTERS)
def test_filter_stops_what_is_constant_but_for_what_its_tail_does_not_reach(name: FilterName) -> None:
    """The kernel falls as ``-1 / (2 pi^2 lag^2)`` on average: its tails beyond ``half`` are ``1 / (pi^2 half)``."""
    half = 400
    leak = ramp_filter(name, 2 * half + 1, 1.0)[half].sum(dtype=np.float64)
    assert leak == pytest.approx(1 / (np.pi**2 * half), rel=0.01)


@pytest.mark.parametrize("samples", [2, 3, 24, 25])
def test_filtering_by_halves_is_the_product_with_the_matrix(samples: int) -> None:
    matrix = ramp_filter("hann", samples, 0.3)
    rays = np.random.default_rng(6).normal(size=(3, samples, 5)).astype(np.float32)
    np.testing.assert_allclose(filter_rays(matrix, rays), matrix @ rays, rtol=0, atol=1e-5)


def test_unknown_filter_is_refused_with_the_choices() -> None:
    with pytest.raises(InputError, match="accepted: ram-lak, shepp-logan, cosine, hann"):
        ramp_filter("ramp", 4, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize(("angles", "samples", "shape"), [(12, 20, (33, 35)), (7, 21, (16, 64)), (1, 2, (3, 2))])
def test_backprojection_equals_interpolating_view_by_view(angles: int, samples: int, shape: tuple[int, int]) -> None:
    rng = np.random.default_rng(1)
    filtered = rng.normal(size=(angles, samples, 3)).astype(np.float32)
    psi = rng.uniform(-10, 10, angles)
    s = centred(samples, 0.3) + 0.1
    y, x = centred(shape[0], 0.2), centred(shape[1], 0.2) + 0.05  # wider than the samples: zero counts outside
    found = backproject(filtered, psi, s[0], 0.3, x, y)
    np.testing.assert_allclose(found, naive_backprojection(filtered, psi, s, x, y), rtol=0, atol=2e-5)


@pytest.mark.parametrize("depth", [1, 16, 17, 64, 70])
def test_slices_are_backprojected_apart_from_each_other_in_any_number(depth: int) -> None:
    rng = np.random.default_rng(5)
    filtered, psi, pixels = rng.normal(size=(6, 11, depth)).astype(np.float32), rng.uniform(0, 7, 6), centred(20, 0.2)
    found = backproject(filtered, psi, -1.5, 0.3, pixels, pixels)
    expected = naive_backprojection(filtered, psi, centred(11, 0.3), pixels, pixels)
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-5)


def test_pixels_within_the_radius_are_as_without_it_and_those_far_beyond_are_zero() -> None:
    filtered, psi, pixels = np.ones((6, 400, 2), np.float32), np.linspace(0, 3, 6), centred(150, 1.0)
    whole = backproject(filtered, psi, -200.0, 1.0, pixels, pixels)
    found = backproject(filtered, psi, -200.0, 1.0, pixels, pixels, radius_mm=50.0)
    from_axis = np.hypot(pixels, pixels[:, None])
    np.testing.assert_array_equal(found[from_axis <= 50], whole[from_axis <= 50])
    assert np.isin(found, [0, *np.unique(whole)]).all()
    assert (found[from_axis > 100] == 0).all()


def test_backprojection_reads_the_very_ends_of_its_samples() -> None:
    filtered = np.ones((1, 5, 1), np.float32)
    x = np.array([-2.001, -2.0, 0.0, 2.0, 2.001])
    np.testing.assert_array_equal(
        backproject(filtered, np.zeros(1), -2.0, 1.0, x, np.zeros(1))[0, :, 0], [0, 1, 1, 1, 0]
    )


@given(st.floats(-3, 3), st.floats(-3, 3), st.integers(0, 2**32 - 1))
def test_backprojection_is_linear(a: float, b: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 6, 9, 2)).astype(np.float32)
    psi, pixels = np.linspace(0, np.pi, 6, endpoint=False), centred(8, 0.5)

    def back(filtered: Float32Array) -> Float32Array:
        return backproject(filtered, psi, -2.0, 0.5, pixels, pixels)

    mixed = back(np.float32(a) * first + np.float32(b) * second)
    np.testing.assert_allclose(mixed, a * back(first) + b * back(second), rtol=0, atol=1e-4)


@given(st.integers(0, 2**32 - 1))
def test_backprojection_is_the_transpose_of_projection_by_linear_splatting(seed: int) -> None:
    """<A x, y> = <x, A' y> with A written out: each pixel's value is dealt to the two samples its ray falls between."""
    rng = np.random.default_rng(seed)
    psi, s, pixels = rng.uniform(0, 7, 5), centred(15, 0.4), centred(7, 0.4)
    image, views = rng.normal(size=(7, 7)), rng.normal(size=(5, 15, 1)).astype(np.float32)
    projected = np.zeros((5, 15))
    x, y = np.meshgrid(pixels, pixels)
    for view, angle in zip(projected, psi, strict=True):
        position = (x * np.cos(angle) - y * np.sin(angle) - s[0]) / 0.4
        index = np.floor(position).astype(int)
        np.add.at(view, index, image * (1 - (position - index)))
        np.add.at(view, index + 1, image * (position - index))
    back = backproject(views, psi, s[0], 0.4, pixels, pixels)[..., 0]
    assert (projected * views[..., 0]).sum() == pytest.approx((image * back).sum(), abs=1e-3)


def test_turning_all_angles_turns_the_picture() -> None:
    rng = np.random.default_rng(4)
    filtered = rng.normal(size=(9, 31, 1)).astype(np.float32)
    psi, pixels = rng.uniform(0, 7, 9), centred(12, 0.7)
    straight = backproject(filtered, psi, -15.0, 1.0, pixels, pixels)
    # x cos(psi + pi/2) - y sin(psi + pi/2) = -y cos(psi) - x sin(psi): what was at (-y, x) is now at (x, y).
    turned = backproject(filtered, psi + np.pi / 2, -15.0, 1.0, pixels, pixels)
    np.testing.assert_allclose(turned, straight[:, ::-1].transpose(1, 0, 2), rtol=0, atol=1e-5)


def test_rays_without_climb_make_the_slices_of_plain_backprojection() -> None:
    rng = np.random.default_rng(2)
    filtered, psi = rng.normal(size=(8, 20, 6)).astype(np.float32), rng.uniform(0, 7, 8)
    heights, pixels = 3 + centred(6, 0.2), centred(30, 0.1)
    tilted = backproject_tilted(filtered, psi, -1.9, 0.2, np.zeros(20), heights, pixels, pixels, heights)
    np.testing.assert_allclose(tilted, backproject(filtered, psi, -1.9, 0.2, pixels, pixels), rtol=0, atol=1e-5)


@pytest.mark.parametrize("levels", [1, 7])
def test_climbing_rays_pass_where_a_plain_reference_puts_them(levels: int) -> None:
    rng = np.random.default_rng(3)
    angles, samples, depth = 5, 24, 60
    filtered, psi = rng.normal(size=(angles, samples, depth)).astype(np.float32), rng.uniform(0, 7, angles)
    s, heights = centred(samples, 0.3), 8 + centred(depth, 0.1)
    tilt = 0.01 + 0.002 * s**2 / s[0] ** 2
    pixels, z_mm = centred(20, 0.2), 8 + centred(levels, 0.2)
    x, y = np.meshgrid(pixels, pixels)
    expected = np.zeros((20, 20, levels))
    for angle, view in zip(psi, filtered, strict=True):
        across, along = x * np.cos(angle) - y * np.sin(angle), x * np.sin(angle) + y * np.cos(angle)
        # The ray through a voxel has the mid-height from which it climbs to the voxel's height on its way `along`.
        mid = z_mm / (1 + along * np.interp(across, s, tilt))[..., None]
        index = np.clip(np.floor((across - s[0]) / 0.3).astype(int), 0, samples - 2)
        weight = (across - s[index]) / 0.3
        for iy, ix in np.ndindex(20, 20):
            left, right = (np.interp(mid[iy, ix], heights, view[index[iy, ix] + side]) for side in (0, 1))
            expected[iy, ix] += (1 - weight[iy, ix]) * left + weight[iy, ix] * right
    found = backproject_tilted(filtered, psi, s[0], 0.3, tilt, heights, pixels, pixels, z_mm)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-4)
