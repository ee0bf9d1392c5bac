"""The closed forms against traced rays, against numbers worked out by hand, and against themselves."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vialight.core.arrays import FloatArray
from vialight.core.config import Optics
from vialight.optics.refraction import (
    VirtualRays,
    camera_to_virtual,
    height_to_camera,
    small_angle_camera_to_virtual,
    transmission,
    virtual_to_camera,
)
from vialight.twin.rays import trace

MACHINES = {
    "shared cases": Optics(12.4, 11.3, 1.472, 1.48, 190.0),
    "near camera": Optics(12.4, 11.3, 1.472, 1.53, 60.0),
    "no glass": Optics(12.4, 12.4, 1.5, 1.48, 145.0),
    "dense glass": Optics(12.4, 11.3, 1.8, 1.48, 145.0),
    "light glass": Optics(12.4, 11.3, 1.33, 1.55, 119.8),
    "thick glass": Optics(20.0, 12.0, 1.52, 1.48, 100.0),
    "water": Optics(12.4, 11.9, 1.52, 1.33, 145.0),
    "telecentric": Optics(12.4, 11.3, 1.472, 1.48, np.inf),
    "telecentric, no glass": Optics(12.4, 12.4, 1.5, 1.53, np.inf),
}

machines = st.builds(
    lambda radius, wall, wall_index, resin_index, distance: Optics(
        radius, radius * (1 - wall), wall_index, resin_index, distance * radius
    ),
    radius=st.floats(1, 50),
    wall=st.one_of(st.just(0.0), st.floats(0.01, 0.3)),
    wall_index=st.floats(1.2, 1.9),
    resin_index=st.floats(1.2, 1.9),
    distance=st.one_of(st.floats(4, 100), st.just(np.inf)),
)
shares = st.floats(-0.99, 0.99)


def traced_virtual(x_c: FloatArray, z_c: FloatArray, optics: Optics) -> VirtualRays:
    """Read off traced rays what `VirtualRays` is defined to be."""
    origin, direction, _ = trace(x_c, z_c, optics)
    plan = np.hypot(direction[..., 0], direction[..., 1])
    sine, cosine = direction[..., 0] / plan, direction[..., 1] / plan
    to_middle = -(origin[..., 0] * sine + origin[..., 1] * cosine)
    slope = direction[..., 2] / plan
    return VirtualRays(
        origin[..., 0] * cosine - origin[..., 1] * sine,
        np.arctan2(sine, cosine),
        origin[..., 2] + to_middle * slope,
        slope,
    )


def columns_across(optics: Optics, count: int = 41) -> FloatArray:
    """Columns from edge to edge of the field."""
    x_c, _ = virtual_to_camera(np.linspace(-0.99, 0.99, count) * optics.field_radius_mm, 0.0, optics)
    return x_c


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
def test_rays_run_where_tracing_puts_them(optics: Optics) -> None:
    x_c, z_c = columns_across(optics), np.linspace(-12, 12, 25)[:, None]
    rays, traced = camera_to_virtual(x_c, z_c, optics), traced_virtual(x_c, z_c, optics)
    assert np.isfinite(rays.virtual_x_mm).all()
    for found, expected in zip(rays, traced, strict=True):
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
def test_pixels_are_found_whose_traced_rays_are_the_ones_wanted(optics: Optics) -> None:
    virtual_x, height = np.linspace(-0.98, 0.98, 41) * optics.field_radius_mm, np.linspace(-11, 11, 23)[:, None]
    traced = traced_virtual(*virtual_to_camera(virtual_x, height, optics), optics)
    assert np.abs(traced.virtual_x_mm - virtual_x).max() < 1e-9
    assert np.abs(traced.mid_height_mm - height).max() < 1e-9


def test_two_rays_are_where_they_are_by_hand() -> None:
    # In the mid-plane the tangent 7/24 makes b = D sin(phi) = 40 * 7/25 = 11.2; R = 56/3 makes b/R = 0.6, n_g = 2 makes
    # b/(n_g R) = 0.3, R_i = 14 makes b/(n_g R_i) = 0.4, n_r = 1.6 makes b/(n_r R_i) = 0.5 and x_v = 7, so that
    # gamma = asin 0.28 - asin 0.6 + asin 0.3 - asin 0.4 + asin 0.5
    #       = 0.2837941 - 0.6435011 + 0.3046927 - 0.4115168 + 0.5235988 = 0.0570677.
    in_plane = camera_to_virtual(40 * 7 / 24, 0.0, Optics(56 / 3, 14.0, 2.0, 1.6, 40.0))
    np.testing.assert_allclose(in_plane, [7.0, 0.0570677, 0.0, 0.0], rtol=0, atol=5e-7)
    # On the axis z_c/D = 3/4 climbs 0.75 a mm with k = 0.6; n_g^2 = 0.36 + 1.2^2 climbs 0.6/1.2 = 0.5, and
    # n_r^2 = 0.36 + 1.5^2 climbs 0.4: 0.75 * 30 up to R = 10, 0.5 * 2 through the glass, 0.4 * 8 to the axis.
    climbing = camera_to_virtual(0.0, 30.0, Optics(10.0, 8.0, np.sqrt(0.36 + 1.44), np.sqrt(0.36 + 2.25), 40.0))
    np.testing.assert_allclose(climbing, [0.0, 0.0, 26.7, 0.4], atol=1e-12)


@given(machines, shares, st.floats(-1, 1))
def test_virtual_to_camera_and_back_changes_nothing(optics: Optics, share: float, height: float) -> None:
    virtual_x, mid_height = share * optics.field_radius_mm, height * optics.outer_radius_mm
    x_c, z_c = virtual_to_camera(virtual_x, mid_height, optics)
    rays = camera_to_virtual(x_c, z_c, optics)
    assume(np.isfinite(rays.direction_rad))  # a steep ray at the edge may miss the resin
    np.testing.assert_allclose(rays.virtual_x_mm, virtual_x, rtol=0, atol=1e-9 * optics.outer_radius_mm)
    np.testing.assert_allclose(rays.mid_height_mm, mid_height, rtol=0, atol=1e-9 * optics.outer_radius_mm)


@given(machines, shares, st.floats(-1, 1))
def test_camera_to_virtual_and_back_changes_nothing(optics: Optics, share: float, height: float) -> None:
    x_c, _ = virtual_to_camera(share * optics.field_radius_mm, 0.0, optics)
    z_c = height * optics.outer_radius_mm
    rays = camera_to_virtual(x_c, z_c, optics)
    assume(np.isfinite(rays.direction_rad))
    back_x, back_z = virtual_to_camera(rays.virtual_x_mm, rays.mid_height_mm, optics)
    scale = optics.outer_radius_mm
    np.testing.assert_allclose(back_x, x_c, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(back_z, z_c, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(height_to_camera(x_c, rays.mid_height_mm, optics), z_c, rtol=0, atol=1e-9 * scale)


@given(machines, shares, st.floats(-1, 1))
def test_left_mirrors_right_and_below_mirrors_above(optics: Optics, share: float, height: float) -> None:
    x_c, z_c = share * optics.outer_radius_mm, height * optics.outer_radius_mm
    rays = np.array(camera_to_virtual(x_c, z_c, optics))
    np.testing.assert_array_equal(np.array(camera_to_virtual(-x_c, z_c, optics)), rays * [-1, -1, 1, 1])
    np.testing.assert_array_equal(np.array(camera_to_virtual(x_c, -z_c, optics)), rays * [1, 1, -1, -1])


@given(shares, st.floats(-10, 10), st.floats(20, 500))
def test_equal_indices_make_it_a_plain_pinhole(share: float, z_c: float, distance: float) -> None:
    x_c = share * 11.0
    rays = camera_to_virtual(x_c, z_c, Optics(12.4, 11.3, 1.0, 1.0, distance))
    phi = np.arctan(x_c / distance)
    # The straight ray from the pupil passes closest to the axis after D cos(phi) of plan view.
    climb = z_c / np.hypot(x_c, distance)
    expected = [distance * np.sin(phi), phi, climb * distance * np.cos(phi), climb]
    np.testing.assert_allclose(rays, expected, rtol=0, atol=1e-12 * distance)


@given(shares, st.floats(-10, 10))
def test_a_telecentric_camera_is_the_limit_of_a_far_one(share: float, z_c: float) -> None:
    far, telecentric = (Optics(12.4, 11.3, 1.472, 1.48, distance) for distance in (1e9, np.inf))
    x_c = share * 12.0
    np.testing.assert_allclose(camera_to_virtual(x_c, z_c, far), camera_to_virtual(x_c, z_c, telecentric), atol=1e-6)
    pixels = virtual_to_camera(x_c / 1.5, z_c, far), virtual_to_camera(x_c / 1.5, z_c, telecentric)
    np.testing.assert_allclose(*pixels, atol=1e-6)


def test_glass_does_not_change_the_distance_from_the_axis_but_the_direction() -> None:
    with_glass, without = (
        camera_to_virtual(0.9 * 12.4, 0.0, Optics(12.4, inner, 1.52, 1.48, 145.0)) for inner in (11.3, 12.4)
    )
    assert with_glass.virtual_x_mm == without.virtual_x_mm
    # optics.md, sensitivities: 0.19 deg at 90 % of the field.
    assert abs(np.degrees(with_glass.direction_rad - without.direction_rad)) == pytest.approx(0.19, abs=0.01)


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
def test_rays_that_miss_the_resin_are_nan(optics: Optics) -> None:
    x_c = (
        np.array([-1.02, 1.02])
        * optics.outer_radius_mm
        / np.sqrt(1 - (optics.outer_radius_mm / optics.distance_mm) ** 2)
    )
    rays, traced = camera_to_virtual(x_c, 5.0, optics), traced_virtual(x_c, np.array(5.0), optics)
    assert np.isnan(rays.direction_rad).all()
    assert np.isnan(rays.mid_height_mm).all()
    assert np.isnan(traced.direction_rad).all()
    assert np.isnan(height_to_camera(x_c, 5.0, optics)).all()


def test_rays_totally_reflected_by_a_lighter_resin_are_nan() -> None:
    # Behind 1.1 mm of glass of any kind, water at 11.3 mm is reached up to b = 1.2 * 9 = 10.8 mm only.
    optics = Optics(12.4, 9.0, 1.5, 1.2, 145.0)
    x_c = np.array([10.7, 10.9])
    assert np.isfinite(camera_to_virtual(x_c, 0.0, optics).direction_rad).tolist() == [True, False]
    assert np.isfinite(trace(x_c, 0.0, optics).direction[:, 0]).tolist() == [True, False]


def test_rays_that_cannot_leave_the_vial_have_no_pixel() -> None:
    optics = MACHINES["shared cases"]
    x_c, z_c = virtual_to_camera([8.37, 8.39, 11.0], 3.0, optics)
    assert np.isfinite(z_c).tolist() == [True, False, False]
    assert np.isfinite(x_c[0])


def test_the_papers_small_angle_forms_are_off_by_24_7_um_and_0_123_deg() -> None:
    """At D = 145 mm and n = 1.48 without glass; the largest errors over the whole field, 12.4 mm / 1.48."""
    optics = Optics(12.4, 12.4, 1.5, 1.48, 145.0)
    x_c, _ = virtual_to_camera(np.linspace(-0.999, 0.999, 2001) * optics.field_radius_mm, 0.0, optics)
    exact = camera_to_virtual(x_c, 0.0, optics)
    virtual_x, direction = small_angle_camera_to_virtual(x_c, optics)
    assert 1e3 * np.abs(virtual_x - exact.virtual_x_mm).max() == pytest.approx(24.7, abs=0.1)
    assert np.degrees(np.abs(direction - exact.direction_rad).max()) == pytest.approx(0.123, abs=0.001)


def test_the_papers_small_angle_forms_are_short_by_r2_over_d2_near_the_axis() -> None:
    """They take ``x_hit / D`` for the ray's angle, and ``x_hit = x_c (1 - R/D)``, which small angles do not mend."""
    optics = Optics(12.4, 12.4, 1.5, 1.48, 145.0)
    x_c = np.array([-0.05, 0.05])
    short = 1 - small_angle_camera_to_virtual(x_c, optics)[0] / camera_to_virtual(x_c, 0.0, optics).virtual_x_mm
    np.testing.assert_allclose(short, (12.4 / 145) ** 2, rtol=1e-3)
    assert small_angle_camera_to_virtual(0.0, optics)[0] == 0


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
def test_as_much_light_gets_through_as_tracing_finds(optics: Optics) -> None:
    x_c, z_c = columns_across(optics), np.linspace(-12, 12, 9)[:, None]
    traced = trace(x_c, z_c, optics).transmission
    np.testing.assert_allclose(transmission(x_c, z_c, optics), traced, rtol=0, atol=1e-10)


def test_light_that_meets_the_glass_straight_on_loses_what_indices_tell() -> None:
    """Each surface reflects ``((n1 - n2) / (n1 + n2))^2``; a vial without a wall has one surface."""
    glass = (1 - (0.472 / 2.472) ** 2) * (1 - (0.008 / 2.952) ** 2)
    assert float(transmission(0.0, 0.0, Optics(12.4, 11.3, 1.472, 1.48, 190.0))) == pytest.approx(glass, abs=1e-12)
    bare = 1 - (0.48 / 2.48) ** 2
    assert float(transmission(0.0, 0.0, Optics(12.4, 12.4, 1.8, 1.48, 190.0))) == pytest.approx(bare, abs=1e-12)
    assert float(transmission(0.0, 0.0, Optics(12.4, 12.4, 1.8, 1.0, 190.0))) == pytest.approx(1, abs=1e-12)


def test_no_light_gets_to_where_no_ray_does() -> None:
    optics = MACHINES["shared cases"]
    x_c = np.array([0.0, 12.2, 13.0, -14.0])
    assert (transmission(x_c, 0.0, optics) > 0).tolist() == [True, True, False, False]
    lighter = Optics(12.4, 9.0, 1.5, 1.2, 145.0)
    assert float(transmission(10.9, 0.0, lighter)) == 0
