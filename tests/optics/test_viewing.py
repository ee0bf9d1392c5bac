"""Pixels' rays against traced ones: where they run, what they light, how much of it arrives."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.optics.refraction import transmission
from vialight.optics.viewing import pixel_rays
from vialight.twin.rays import trace

CAMERA = Camera(distance_mm=119.8, pixel_mm=0.065, axis_column=195.5, optical_row=60.0)
OPTICS = {
    "paper": Optics(12.4, 11.3, 1.472, 1.49, 119.8),
    "no glass": Optics(12.4, 12.4, 1.5, 1.49, 119.8),
    "telecentric": Optics(12.4, 11.3, 1.472, 1.49, np.inf),
    "index matched": Optics(12.4, 11.3, 1.0, 1.0, 119.8),
}
COLUMNS, ROWS = 392, 120


def closest_points(x_c: FloatArray, z_c: FloatArray, optics: Optics) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return traced x_v, mid-height and length of path up to the point closest to the axis."""
    origin, direction, _ = trace(x_c, z_c, optics)
    plan = np.hypot(direction[..., 0], direction[..., 1])
    sine, cosine = direction[..., 0] / plan, direction[..., 1] / plan
    to_middle = -(origin[..., 0] * sine + origin[..., 1] * cosine)
    across = origin[..., 0] * cosine - origin[..., 1] * sine
    return across, origin[..., 2] + to_middle * direction[..., 2] / plan, to_middle / plan


@pytest.mark.parametrize("optics", OPTICS.values(), ids=OPTICS)
@pytest.mark.parametrize("absorption", [0.0, 0.08])
def test_delivery_is_traced_light_over_traced_area(optics: Optics, absorption: float) -> None:
    """Neighbouring rays traced: areas by differences of 0.1 um, loss by Fresnel as vectors and by length of path."""
    rays = pixel_rays(COLUMNS, ROWS, CAMERA, optics, absorption)
    x_c = (np.arange(COLUMNS, dtype=np.float64) - CAMERA.axis_column) * CAMERA.pixel_mm
    z_c = (CAMERA.optical_row - np.arange(ROWS, dtype=np.float64))[:, None] * CAMERA.pixel_mm
    x_c, z_c = np.broadcast_arrays(x_c, z_c)
    d = 1e-4
    (right, right_z, _), (left, left_z, _) = (closest_points(x_c + side, z_c, optics) for side in (d, -d))
    (up_x, up, _), (down_x, down, _) = (closest_points(x_c, z_c + side, optics) for side in (d, -d))
    area = ((right - left) * (up - down) - (right_z - left_z) * (up_x - down_x)) / (2 * d) ** 2
    _, _, path = closest_points(x_c, z_c, optics)
    expected = trace(x_c, z_c, optics).transmission * np.exp(-absorption * path) / area
    inner = np.abs(rays.virtual_x_mm) < 0.97 * optics.field_radius_mm
    assert inner.mean() > 0.8
    np.testing.assert_allclose(rays.delivery[inner], expected[inner], rtol=3e-4)


@pytest.mark.parametrize("optics", OPTICS.values(), ids=OPTICS)
def test_light_handed_on_is_light_sent_less_what_is_reflected(optics: Optics) -> None:
    """Without absorption: delivery times the area lit is the pixel's area times its transmission."""
    rays = pixel_rays(COLUMNS, ROWS, CAMERA, optics)
    x_c = (np.arange(COLUMNS, dtype=np.float64) - CAMERA.axis_column) * CAMERA.pixel_mm
    z_c = (CAMERA.optical_row - np.arange(ROWS, dtype=np.float64))[:, None] * CAMERA.pixel_mm
    lit = rays.delivery > 0
    handed_on = (rays.delivery * rays.width_mm * rays.height_mm)[lit]
    np.testing.assert_allclose(handed_on, (transmission(x_c, z_c, optics) * CAMERA.pixel_mm**2)[lit], rtol=1e-9)


@pytest.mark.parametrize("optics", OPTICS.values(), ids=OPTICS)
def test_neighbouring_pixels_light_neighbouring_patches(optics: Optics) -> None:
    rays = pixel_rays(COLUMNS, ROWS, CAMERA, optics)
    gaps = np.diff(rays.virtual_x_mm, axis=1) - (rays.width_mm[:, 1:] + rays.width_mm[:, :-1]) / 2
    whole = np.abs(rays.virtual_x_mm[:, 1:]) < 0.97 * optics.field_radius_mm
    assert np.abs(gaps[whole]).max() < 1e-4
    tall = -np.diff(rays.mid_height_mm, axis=0) - (rays.height_mm[1:] + rays.height_mm[:-1]) / 2
    assert np.nanmax(np.abs(tall[:, 60:-60])) < 1e-6


def test_pixels_beside_the_vial_deliver_nothing() -> None:
    rays = pixel_rays(500, 3, CAMERA.model_copy(update={"axis_column": 249.5, "optical_row": 1.0}), OPTICS["paper"])
    beside = np.abs(np.arange(500) - 249.5) * 0.065 > 12.6
    assert (rays.delivery[:, beside] == 0).all()
    assert np.isfinite(rays.delivery).all()
    assert (rays.delivery[:, ~beside][:, 20:-20] > 0).all()


def test_without_a_vial_a_pixel_lights_itself() -> None:
    rays = pixel_rays(4, 3, Camera(pixel_mm=0.5, axis_column=1.0, optical_row=2.0), None, 0.1)
    np.testing.assert_array_equal(rays.virtual_x_mm[0], [-0.5, 0, 0.5, 1])
    np.testing.assert_array_equal(rays.mid_height_mm[:, 0], [1, 0.5, 0])
    assert (rays.width_mm == 0.5).all()
    assert (rays.height_mm == 0.5).all()
    assert (rays.delivery == 1).all()
    assert (rays.direction_rad == 0).all()


def test_the_vial_is_a_lens_that_brightens_its_middle() -> None:
    """On the axis ``x_v = x_c / n``: light is n times as dense there, less reflection and what z spreads."""
    rays = pixel_rays(3, 3, Camera(pixel_mm=0.01, axis_column=1.0, optical_row=1.0), OPTICS["telecentric"])
    expected = 1.49 * float(transmission(0.0, 0.0, OPTICS["telecentric"]))
    assert rays.delivery[1, 1] == pytest.approx(expected, rel=1e-5)
