"""Dose against what can be worked out without the twin: constants, quadrature, energy, forward-traced rays."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import quad

from twin.rigs import PIXEL_MM, patterns_of, printer, printer_without_glass
from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.twin.exposure import add_dose, dose_of, exposer_for, writing_optics
from vialight.twin.lightfield import light_field
from vialight.twin.poses import Pose
from vialight.twin.rays import points_on_disk, trace


def white(angles: int, rows: int = 120, columns: int = 380) -> np.ndarray:
    return np.full((angles, rows, columns), 255, np.uint8)


def lit_by(images: np.ndarray, rig: Rig, grid: Grid, pose: Pose, blur_mm: float = 0.0) -> np.ndarray:
    """Dose (y, x, z) of one image in one pose."""
    patterns = patterns_of(images)
    exposer = exposer_for(rig, float(np.abs(grid.z_mm).max()), blur_mm=blur_mm)
    dose = np.zeros((grid.shape[1], grid.shape[2], grid.shape[0]), np.float32)
    corner = (patterns.first_row, patterns.first_column)
    add_dose(dose, exposer, images, corner, np.array([0]), [pose], np.array([1.0]), grid)
    return dose


def test_white_patterns_without_glass_or_absorption_bring_one_constant() -> None:
    patterns = patterns_of(white(8), 0.01)
    dose = dose_of(patterns, printer_without_glass(0.0), Grid((5, 41, 41), 0.25), turns=2)
    np.testing.assert_allclose(dose, 2 * 2 * np.pi * 255 * 0.01, rtol=2e-6)


def test_absorbed_dose_of_a_disk_is_that_of_quadrature() -> None:
    absorption, radius = 0.08, 12.4
    images = white(90)
    images[:, :, np.abs(np.arange(380) - 189.5) * PIXEL_MM > 6] = 0  # a disk's silhouette, 12 mm across
    grid = Grid((1, 45, 45), 0.25)
    dose = dose_of(patterns_of(images), printer_without_glass(absorption), grid)[0]

    def expected(r: float) -> float:
        def reaching(angle: float) -> float:
            depth = np.sqrt(radius**2 - (r * np.sin(angle)) ** 2) + r * np.cos(angle)
            return float(255 * np.exp(-absorption * depth))

        return 2 * quad(reaching, 0, np.pi)[0]

    r = np.hypot(grid.x_mm, grid.y_mm[:, None])
    inside = r < 5.9
    curve = np.interp(r[inside], np.linspace(0, 6, 61), [expected(value) for value in np.linspace(0, 6, 61)])
    assert np.abs(dose[inside] / curve - 1).max() < 5e-4


@pytest.mark.parametrize("distance", [119.8, np.inf])
def test_light_taken_from_rays_is_light_absorbed_in_voxels(distance: float) -> None:
    absorption, radius, voxel = 0.08, 7.0, 0.2
    rig, images = printer(absorption, distance_mm=distance), white(1, rows=80)  # 26 voxels high
    grid = Grid((46, 76, 76), voxel)
    dose = lit_by(images, rig, grid, Pose(0.3))
    inside = np.hypot(grid.x_mm, grid.y_mm[:, None]) < radius
    absorbed = absorption * dose[inside].sum() * voxel**3

    x_c = (np.arange(380) - 189.5) * PIXEL_MM
    z_c = (np.arange(80) - 39.5)[:, None] * PIXEL_MM
    origin, direction, transmission = trace(x_c, z_c, writing_optics(rig))
    plan = np.hypot(direction[..., 0], direction[..., 1])
    to_middle = -(origin[..., :2] * direction[..., :2]).sum(axis=-1) / plan**2
    miss = np.hypot(*np.moveaxis(origin[..., :2] + to_middle[..., None] * direction[..., :2], -1, 0))
    half = np.sqrt(np.clip(radius**2 - miss**2, 0, None)) / plan
    taken = transmission * (np.exp(-absorption * (to_middle - half)) - np.exp(-absorption * (to_middle + half)))
    assert absorbed == pytest.approx(255 * PIXEL_MM**2 * np.nansum(taken), rel=2e-3)


def test_the_light_field_points_at_the_ray_that_passes() -> None:
    optics = writing_optics(printer())
    field = light_field(optics, 0.0, height_mm=10.0)
    rng = np.random.default_rng(2)
    half = len(field.coefficients) // 2
    i, j = rng.integers(-half + 8, half - 8, (2, 2000))
    x, y, z = (i + 0.5) * field.lattice_mm, (j + 0.5) * field.lattice_mm, rng.uniform(-10, 10, 2000)
    kept = np.hypot(x, y) < field.reach_mm - 0.2
    corners = sum(field.coefficients[half + j + b, half + i + a] for a in (0, 1) for b in (0, 1)) / 4
    powers = np.vander(z, 4, increasing=True)
    x_c, z_c = np.einsum("nqk,nk->qn", corners[:, :2], powers)
    origin, direction, _ = trace(x_c[kept], z_c[kept], optics)
    place = np.stack([x, y, z], axis=1)[kept]
    gap = place - origin
    gap -= (gap * direction).sum(axis=1, keepdims=True) * direction
    missed = np.linalg.norm(gap, axis=1)
    assert missed[np.hypot(place[:, 0], place[:, 1]) < 7].max() < 1e-3
    assert missed.max() < 0.01


def test_the_projector_stands_where_its_azimuth_says() -> None:
    """Pupil at (-D, 0, 0), looking along +x: its right is lab -y, and a turned object is lit elsewhere."""
    image = np.zeros((1, 121, 381), np.uint8)
    image[0, 30, 260] = 255  # to the right and up
    grid = Grid((81, 121, 121), 0.1)
    for angle, (sign_x, sign_y) in {0.0: (0, -1), np.pi / 2: (-1, 0), np.pi: (0, 1)}.items():
        y, x, z = np.nonzero(lit_by(image, printer(), grid, Pose(angle)) > 0)
        assert grid.z_mm[z].min() > 1.5
        if sign_x:
            assert (sign_x * grid.x_mm[x]).min() > 1.5
        else:
            assert (sign_y * grid.y_mm[y]).min() > 1.5


def test_a_shifted_object_is_lit_elsewhere() -> None:
    rng = np.random.default_rng(3)
    image = rng.integers(0, 255, (1, 120, 300)).astype(np.uint8)
    grid = Grid((11, 61, 61), 0.1)
    straight = lit_by(image, printer(), grid, Pose(0.0), 0.1)
    shifted = lit_by(image, printer(), grid, Pose(0.0, shift_mm=(0.3, -0.2)), 0.1)
    np.testing.assert_allclose(shifted[2:, :-3], straight[:-2, 3:], rtol=1e-4, atol=1e-3)
    leaning = lit_by(image, printer(), grid, Pose(0.0, tilt_rad=(0.0, 0.2)), 0.1)
    top = grid.z_mm[-1]
    moved = lit_by(image, printer(), Grid((1, 61, 61), 0.1, top), Pose(0.0, shift_mm=(0.0, 0.2 * top)), 0.1)
    middle = np.abs(grid.y_mm) < 0.06  # where a lean does not raise or sink
    np.testing.assert_allclose(leaning[middle, :, -1], moved[middle, :, 0], atol=4.0)
    assert np.abs(straight[middle, :, -1] - moved[middle, :, 0]).max() > 10


def test_blur_spreads_light_and_keeps_it() -> None:
    image = np.zeros((1, 121, 381), np.uint8)
    image[0, 60, 190] = 255
    grid = Grid((151, 151, 1), PIXEL_MM / 5)
    sharp, soft = (lit_by(image, printer_without_glass(0.0), grid, Pose(0.0), blur)[:, 0, :] for blur in (0.0, 0.13))
    assert soft.sum() == pytest.approx(sharp.sum(), rel=5e-3)
    assert soft.sum() * grid.voxel_mm**2 == pytest.approx(255 * PIXEL_MM**2, rel=5e-3)
    profile = soft.sum(axis=1) / soft.sum()
    centre = (profile * grid.y_mm).sum()
    variance = (profile * (grid.y_mm - centre) ** 2).sum()
    assert variance == pytest.approx(0.13**2 + PIXEL_MM**2 / 6, rel=2e-2)


def test_an_open_aperture_blurs_away_from_the_focus_and_keeps_the_light() -> None:
    """Without a vial, an edge at 4 mm from the focus is as wide as the pupil's disk over D times 4 mm."""
    rig = printer_without_glass(0.0)
    projector = rig.need_projector().model_copy(update={"distance_mm": 120.0})
    rig = rig.model_copy(update={"projector": projector})
    exposer = exposer_for(rig, 1.0, pupil_mm=points_on_disk(60, 12.0))
    image = np.zeros((1, 61, 381), np.uint8)
    image[0, :, 170:211] = 255
    grid, corner = Grid((1, 90, 90), 0.1), (354, 322)
    dose = np.zeros((90, 90, 1), np.float32)
    add_dose(dose, exposer, image, corner, np.array([0]), [Pose(0.0)], np.array([1.0]), grid)
    # The projector looks along +x: columns of the image lie along y.
    at_focus, far = (dose[:, np.argmin(np.abs(grid.x_mm - x)), 0] for x in (0.05, 4.05))
    slopes = [np.abs(np.gradient(line, grid.y_mm)).max() for line in (at_focus, far)]
    assert slopes[0] > 255 / 0.25
    # The chord of a disk of radius a is 2 a long, of area pi a^2: the steepest slope is 2 / (pi a).
    assert slopes[1] == pytest.approx(255 * 2 / (np.pi * 12.0 * 4.05 / 120), rel=0.15)
    assert far.sum() == pytest.approx(at_focus.sum(), rel=0.05)


def test_points_in_a_voxel_average_what_finer_voxels_see() -> None:
    rng = np.random.default_rng(4)
    patterns = patterns_of(rng.integers(0, 255, (6, 90, 300)).astype(np.uint8))
    coarse = dose_of(patterns, printer(), Grid((4, 10, 10), 0.4), points_a_voxel=(2, 2, 2))
    fine = dose_of(patterns, printer(), Grid((8, 20, 20), 0.2))
    np.testing.assert_allclose(coarse, fine.reshape(4, 2, 10, 2, 10, 2).mean(axis=(1, 3, 5)), rtol=1e-4)


def test_patterns_stay_while_the_stage_moves_on() -> None:
    rng = np.random.default_rng(5)
    held = patterns_of(rng.integers(0, 255, (10, 60, 300)).astype(np.uint8))
    grid = Grid((2, 21, 21), 0.4)
    often = patterns_of(np.repeat(held.levels, 5, axis=0))
    often = type(often)(often.levels, often.angles_rad - 2 * often.step_rad, often.first_row, often.first_column, 1.0)
    np.testing.assert_allclose(
        dose_of(held, printer(), grid, angles_a_pattern=5), dose_of(often, printer(), grid), rtol=1e-4
    )


def test_a_rig_that_cannot_print_is_told_in_one_line() -> None:
    rig = printer()
    dark = rig.model_copy(update={"resin": rig.resin.model_copy(update={"absorption_per_mm": None})})
    with pytest.raises(InputError, match="absorption_per_mm"):
        dose_of(patterns_of(white(2)), dark, Grid((2, 2, 2), 0.5))
    flat = rig.model_copy(update={"geometry": "parallel"})
    with pytest.raises(InputError, match="parallel"):
        dose_of(patterns_of(white(2)), flat, Grid((2, 2, 2), 0.5))
