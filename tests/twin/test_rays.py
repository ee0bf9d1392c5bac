"""Traced rays against closed forms written down elsewhere, and against what every surface must keep."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.core.config import Optics
from vialight.optics.refraction import camera_to_virtual
from vialight.twin.rays import points_on_disk, trace

MACHINES = {
    "paper": Optics(12.4, 11.3, 1.472, 1.48, 190.0),
    "projector": Optics(12.4, 11.3, 1.472, 1.55, 119.8),
    "no glass": Optics(12.4, 12.4, 1.5, 1.48, 145.0),
    "dense glass": Optics(12.4, 11.3, 1.9, 1.33, 60.0),
    "telecentric": Optics(12.4, 11.3, 1.472, 1.48, np.inf),
}


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
@pytest.mark.parametrize("azimuth", [0.0, -np.pi / 2, 0.7])
def test_rays_lie_where_the_closed_form_has_them(optics: Optics, azimuth: float) -> None:
    x_c, z_c = np.linspace(-11.5, 11.5, 47), np.linspace(-12, 12, 25)[:, None]
    rays, known = trace(x_c, z_c, optics, azimuth_rad=azimuth), camera_to_virtual(x_c, z_c, optics)
    assert np.isfinite(rays.origin_mm).any()
    np.testing.assert_array_equal(np.isfinite(rays.origin_mm[..., 0]), np.isfinite(known.virtual_x_mm))
    # psi at stage angle 0: the line x cos(psi) - y sin(psi) = x_v, run through along (sin(psi), cos(psi)).
    psi = known.direction_rad - azimuth
    (x, y, z), (dx, dy, dz) = np.moveaxis(rays.origin_mm, -1, 0), np.moveaxis(rays.direction, -1, 0)
    np.testing.assert_allclose(x * np.cos(psi) - y * np.sin(psi), known.virtual_x_mm, rtol=0, atol=1e-9)
    plan = np.hypot(dx, dy)
    np.testing.assert_allclose(dx / plan, np.sin(psi), rtol=0, atol=1e-11)
    np.testing.assert_allclose(dy / plan, np.cos(psi), rtol=0, atol=1e-11)
    np.testing.assert_allclose(dz / plan, known.slope, rtol=0, atol=1e-11)
    from_middle = x * np.sin(psi) + y * np.cos(psi)
    np.testing.assert_allclose(z - from_middle * known.slope, known.mid_height_mm, rtol=0, atol=1e-9)


@pytest.mark.parametrize("optics", MACHINES.values(), ids=MACHINES)
def test_rays_from_anywhere_in_the_pupil_keep_what_a_cylinder_keeps(optics: Optics) -> None:
    """A cylinder keeps n times the direction's z and n times its moment about z, whatever a ray's skewness."""
    rng = np.random.default_rng(1)
    x_c, z_c = rng.uniform(-9, 9, 500), rng.uniform(-9, 9, 500)
    disk = points_on_disk(500, 0.03 if np.isinf(optics.distance_mm) else 6.0)
    focus = 3.0
    rays = trace(x_c, z_c, optics, pupil=(disk[:, 0], disk[:, 1]), focus_mm=focus)
    if np.isinf(optics.distance_mm):
        point, start = (
            np.stack([x_c, np.full(500, focus), z_c], axis=1),
            np.stack([disk[:, 0], np.ones(500), disk[:, 1]], axis=1),
        )
    else:
        stretch = 1 + focus / optics.distance_mm
        point = np.stack([x_c * stretch, np.full(500, focus), z_c * stretch], axis=1)
        start = point - np.stack([disk[:, 0], np.full(500, -optics.distance_mm), disk[:, 1]], axis=1)
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    lit = rays.transmission > 0
    assert lit.sum() > 400
    before = np.cross(point, start)[:, 2]
    after = optics.resin_index * np.cross(rays.origin_mm, rays.direction)[:, 2]
    np.testing.assert_allclose(after[lit], before[lit], rtol=0, atol=1e-9)
    np.testing.assert_allclose(optics.resin_index * rays.direction[lit, 2], start[lit, 2], rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(rays.direction[lit], axis=1), 1, rtol=0, atol=1e-14)
    np.testing.assert_allclose(np.hypot(*rays.origin_mm[lit, :2].T), optics.inner_radius_mm, rtol=0, atol=1e-12)


def test_light_along_the_axis_loses_what_fresnel_says() -> None:
    reflected = [((b - a) / (b + a)) ** 2 for a, b in ((1.0, 1.472), (1.472, 1.55))]
    transmission = trace(0.0, 0.0, MACHINES["projector"]).transmission
    np.testing.assert_allclose(transmission, np.prod([1 - share for share in reflected]), rtol=1e-14)


def test_light_at_brewsters_angle_loses_one_polarisation_only() -> None:
    index = 1.48
    optics = Optics(12.4, 12.4, 1.5, index, np.inf)
    angle = np.arctan(index)
    across = (np.cos(angle) - index * np.cos(np.pi / 2 - angle)) / (np.cos(angle) + index * np.cos(np.pi / 2 - angle))
    transmission = trace(12.4 * np.sin(angle), 0.0, optics).transmission
    np.testing.assert_allclose(transmission, 1 - across**2 / 2, rtol=1e-12)


def test_rays_that_miss_or_are_reflected_totally_bring_nothing() -> None:
    optics = Optics(12.4, 11.3, 1.05, 1.33, np.inf)
    x_c = np.array([12.5, 12.3, 0.0])  # beside the vial; through the glass alone; into the resin
    assert (trace(x_c, 0.0, optics).transmission > 0).tolist() == [False, False, True]
    # Glass of 1.9 to resin of 1.05 reflects totally beyond r = 1.05 / 1.9 of the inner radius.
    edge = Optics(12.4, 11.3, 1.9, 1.05, np.inf)
    impact = 1.05 * 11.3 * np.array([0.999, 1.001])
    assert (trace(impact, 0.0, edge).transmission > 0).tolist() == [True, False]
