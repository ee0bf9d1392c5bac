from __future__ import annotations

import numpy as np
import pytest

from calibration.standards import PIXEL_MM, height_map
from vialight.calibration.threshold.height_maps import circle_in_heights
from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError

ROW, COLUMN = np.mgrid[:300, :320] * PIXEL_MM


def stood(inside: FloatArray, height_mm: float = 5.0) -> FloatArray:
    noise = np.random.default_rng(1).normal(0, 0.01, inside.shape)
    return np.asarray(np.where(inside, height_mm, 0.0) + noise)


def test_a_circle_is_found_to_a_thirtieth_of_a_pixel_and_its_uncertainty_covers_it() -> None:
    rng, off = np.random.default_rng(0), []
    for draw in range(12):
        radius, centre = 4.5 + rng.random(), (6.5 + rng.random(), 6.5 + rng.random())
        circle = circle_in_heights(height_map(radius, centre, size=280, seed=draw), PIXEL_MM)
        off.append(
            [
                circle.radius_mm - radius,
                (circle.radius_mm - radius) / circle.radius_std_mm,
                (circle.x_mm - centre[0]) / circle.centre_std_mm,
            ]
        )
    assert np.abs(off)[:, 0].max() < PIXEL_MM / 30
    assert (np.abs(off)[:, 1:] < 2).mean() > 0.85


def test_a_flank_that_was_not_seen_makes_the_diameter_as_uncertain_as_it_is_wide() -> None:
    radius = np.hypot(COLUMN - 8.01, ROW - 7.52)
    heights = stood(radius < 5.0)
    heights[(radius > 5.0) & (radius < 5.2)] = np.nan
    circle = circle_in_heights(heights, PIXEL_MM)
    assert circle.radius_mm == pytest.approx(5.1, abs=0.02)
    assert circle.radius_std_mm == pytest.approx(0.2 / np.sqrt(12), rel=0.2)


def test_a_beaded_rim_dust_and_tilt_do_not_move_the_circle() -> None:
    radius = np.hypot(COLUMN - 8.01, ROW - 7.52)
    heights = stood(radius < 5.0) + 0.02 * COLUMN
    heights[(radius < 5.0) & (radius > 4.6)] += 0.3
    heights[np.random.default_rng(2).random(heights.shape) < 0.005] = 9.0
    circle = circle_in_heights(heights, PIXEL_MM)
    assert circle.radius_mm == pytest.approx(5.0, abs=0.005)
    assert (circle.x_mm, circle.y_mm) == pytest.approx((8.01, 7.52), abs=0.005)


def test_a_map_of_the_top_alone_will_do() -> None:
    radius = np.hypot(COLUMN - 8.01, ROW - 7.52)
    circle = circle_in_heights(np.where(radius < 5.0, stood(radius < 5.0), np.nan), PIXEL_MM)
    assert circle.radius_mm == pytest.approx(5.0, abs=0.01)


NO_CIRCLES = {
    "two": (stood((np.hypot(COLUMN - 5, ROW - 5) < 3) | (np.hypot(COLUMN - 11.5, ROW - 10) < 3.2)), "two circles"),
    "square": (stood((abs(COLUMN - 8) < 4) & (abs(ROW - 7.5) < 4)), "no circle|square"),
    "ellipse": (stood(np.hypot((COLUMN - 8) / 1.08, ROW - 7.5) < 4.5), "ellipse"),
    "cone": (stood(ROW > -1, 0.0) + 5 * np.clip(5.2 - np.hypot(COLUMN - 8, ROW - 7.5), 0, 1), "cone"),
    "flat": (stood(ROW > -1, 0.0), "no step"),
    "half of it": (stood(np.hypot(COLUMN - 16, ROW - 7.5) < 5), "no circle|of its way round"),
    "a straight edge": (stood(COLUMN > 8), "no circle"),
}


@pytest.mark.parametrize(("heights", "told"), NO_CIRCLES.values(), ids=NO_CIRCLES)
def test_what_is_not_one_circle_is_refused(heights: FloatArray, told: str) -> None:
    with pytest.raises(InputError, match=told):
        circle_in_heights(heights, PIXEL_MM, "heights.npy")
