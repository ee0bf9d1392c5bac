from __future__ import annotations

import sys
from typing import Any

import numpy as np
import pytest

from calibration.standards import cylinder, cylinder_mesh, volume_of
from vialight.calibration.threshold.by_rim import overhead, radius_at, rim_threshold, weighted_mean
from vialight.calibration.threshold.by_surface import surface_threshold
from vialight.core.arrays import Grid, Volume
from vialight.core.errors import InputError
from vialight.metrology import Registration

GRID = Grid((60, 90, 90), 0.1)
COARSE = Grid((32, 48, 48), 0.18)


def standard(x: Any, y: Any, z: Any) -> Any:
    return cylinder(x, y, z, 3.0, 2.0, (0.33, -0.21))


def test_the_density_on_the_rim_of_a_decentred_cylinder_is_that_of_its_surface() -> None:
    seen = overhead(volume_of(standard, GRID, blur_mm=0.1, noise=5.0), GRID)
    found = rim_threshold(seen, 3.0)
    assert (seen.circle.x_mm, seen.circle.y_mm) == pytest.approx((0.33, -0.21), abs=1e-3)
    assert (seen.bottom_mm, seen.top_mm) == pytest.approx((-2.0, 2.0), abs=0.03)
    # The blur's share: s^2 / (2 R) within the surface, times the slope.
    expected = 100.0 - found.slope_per_mm * 0.1**2 / (2 * 3.0)
    assert found.threshold == pytest.approx(expected, abs=0.3)
    assert abs(found.threshold - 100.0) < 2 * found.std
    assert 2 * radius_at(seen, found.threshold).radius_mm == pytest.approx(6.0, abs=2e-3)


def test_fitting_the_centre_takes_the_two_humps_away() -> None:
    seen = overhead(volume_of(standard, GRID, blur_mm=0.1, noise=2.0), GRID)
    found = rim_threshold(seen, 3.0)
    assert found.decentred.std() > 10 * found.spread


def shape(radius: Any, half_mm: float = 2.0) -> Any:
    def distance(x: Any, y: Any, z: Any) -> Any:
        return np.maximum(radius(x, y, z), np.abs(z) - half_mm)

    return distance


NO_CYLINDERS = {
    "ellipse": (shape(lambda x, y, z: np.hypot(x / 1.1, y) - 3.0), "no circle|ellipse"),
    "square": (shape(lambda x, y, z: np.maximum(abs(x), abs(y)) - 2.5), "no circle|square"),
    "cone": (shape(lambda x, y, z: np.hypot(x, y) - 3.0 - 0.1 * z), "from bottom to top"),
    "two": (
        shape(lambda x, y, z: np.minimum(np.hypot(x - 2, y - 2) - 1.6, np.hypot(x + 2, y + 1) - 1.7)), "two circles"
    ),
    "nothing": (lambda x, y, z: 0 * x + 9.0, "nothing has cured"),
    "a disc": (shape(lambda x, y, z: np.hypot(x, y) - 3.0, half_mm=0.3), "mm high"),
}  # fmt: skip


@pytest.mark.parametrize(("distance", "told"), NO_CYLINDERS.values(), ids=NO_CYLINDERS)
def test_what_is_no_cylinder_is_refused(distance: Any, told: str) -> None:
    with pytest.raises(InputError, match=told):
        overhead(volume_of(distance, GRID, noise=5.0), GRID, "frames.h5")


def test_another_cylinders_profile_is_refused() -> None:
    seen = overhead(volume_of(standard, GRID), GRID)
    with pytest.raises(InputError, match="profile"):
        rim_threshold(seen, 3.4)


def test_the_median_density_on_a_turned_and_shifted_surface_is_the_threshold() -> None:
    volume = Volume(volume_of(standard, COARSE, blur_mm=0.1, noise=5.0), COARSE)
    scan = cylinder_mesh(3.0, 4.0)
    shift = np.eye(4)
    angle = np.radians(4.0)
    shift[:3, :3] = [[1, 0, 0], [0, np.cos(angle), -np.sin(angle)], [0, np.sin(angle), np.cos(angle)]]
    shift[:3, 3] = [0.9, -0.4, 0.2]
    found = surface_threshold(volume, scan.moved(shift))
    assert abs(found.threshold - 100.0) < 0.01 * found.slope_per_mm
    assert found.slope_per_mm == pytest.approx(200 / np.sqrt(2 * np.pi * (0.1**2 + 0.08**2)), rel=0.15)


def test_a_surface_of_something_else_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    as_placed = Registration(np.eye(4), ())  # wherever it is laid, it does not fit; looking for where takes long
    module = sys.modules["vialight.calibration.threshold.by_surface"]  # by attribute, it is the function
    monkeypatch.setattr(module, "register", lambda *meshes: as_placed)
    volume = Volume(volume_of(standard, COARSE), COARSE)
    with pytest.raises(InputError, match="of its area"):
        surface_threshold(volume, cylinder_mesh(1.5, 6.0), "scan.stl")


def test_standards_that_differ_make_their_mean_as_uncertain_as_they_differ() -> None:
    assert weighted_mean([99.0, 100.0, 101.0], [0.1, 0.1, 0.1])[1] == pytest.approx(1 / np.sqrt(3))
    assert weighted_mean([100.0, 100.0], [0.1, 0.1])[1] == pytest.approx(0.1 / np.sqrt(2))
