"""The judge: scores counted by hand, doses from constants."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.rigs import patterns_of, printer, printer_without_glass
from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.planning.scoring import dose_of_patterns, judged_voxels, score_dose


def row(*values: float) -> Float32Array:
    return np.array([[values]], np.float32)


ALL = np.ones((1, 1, 1), bool)


def test_a_score_is_what_counting_by_hand_gives() -> None:
    """Part 1.0 0.8 0.6, void 0.7 0.6 0.2 0.1: two voids get the least in-part dose or more, of seven voxels.

    At a threshold of 0.8 two of three are cured and no void: 2/3; at 0.6 all three, and two voids: 3/5.
    """
    score = score_dose(row(1.0, 0.8, 0.6, 0.7, 0.6, 0.2, 0.1), row(1, 1, 1, 0, 0, 0, 0), ALL)
    assert score.voxel_error_rate == pytest.approx(2 / 7)
    assert score.process_window == pytest.approx(-0.1)
    assert score.in_part_dose_range == pytest.approx(0.4)
    assert score.jaccard == pytest.approx(2 / 3)
    assert score.best_threshold == pytest.approx(0.8)
    assert score.in_part_mean == pytest.approx(0.8)
    assert score.in_part_std == pytest.approx(math.sqrt(0.08 / 3))
    assert score.void_max == pytest.approx(0.7)
    assert math.isnan(score.light_efficiency)


def test_relative_figures_are_shares_of_the_largest_in_part_dose() -> None:
    once = score_dose(row(1.0, 0.8, 0.5), row(1, 1, 0), ALL)
    twice = score_dose(row(2.0, 1.6, 1.0), row(1, 1, 0), ALL)
    assert twice.process_window == pytest.approx(once.process_window)
    assert twice.in_part_dose_range == pytest.approx(once.in_part_dose_range)
    assert twice.best_threshold == pytest.approx(2 * once.best_threshold)


def test_voxels_that_are_not_judged_do_not_count() -> None:
    judged = np.array([[[True, True, True, False, False]]])
    score = score_dose(row(1.0, 0.9, 0.2, 5.0, 0.0), row(1, 1, 0, 0, 1), judged)
    assert (score.jaccard, score.voxel_error_rate) == (1.0, 0.0)
    assert score.void_max == pytest.approx(0.2)


def test_half_covered_voxels_are_meant_to_cure() -> None:
    score = score_dose(row(1.0, 0.9, 0.2), row(1, 0.5, 0.49), ALL)
    assert score.process_window == pytest.approx(0.7)


@given(st.lists(st.tuples(st.floats(0, 2, width=32), st.booleans()), min_size=2, max_size=30))
def test_jaccard_is_the_best_that_any_threshold_gives(voxels: list[tuple[float, bool]]) -> None:
    dose, part = row(*(d for d, _ in voxels)), np.array([[[p for _, p in voxels]]])
    if not part.any() or dose[part].max() == 0:
        return
    score = score_dose(dose, part.astype(np.float32), ALL)
    tried = [((dose >= t) & part).sum() / ((dose >= t) | part).sum() for t in np.unique(dose)]
    assert score.jaccard == pytest.approx(max(tried))


def test_light_efficiency_is_the_mean_level() -> None:
    levels = np.zeros((4, 10, 20))
    levels[:, :5] = 255
    score = score_dose(row(1, 0), row(1, 0), ALL, patterns_of(levels))
    assert score.light_efficiency == pytest.approx(0.5)


def test_the_circle_in_the_grid_is_judged() -> None:
    judged = judged_voxels(Grid((3, 40, 40), 0.1))
    assert judged.shape == (1, 40, 40)
    assert judged.mean() == pytest.approx(np.pi / 4, rel=0.01)


PARALLEL = Rig.model_validate({
    "geometry": "parallel",
    "projector": {"distance_mm": 100.0, "pixel_mm": 0.065, "columns": 1024, "rows": 768, "axis_column": 511.5,
                  "azimuth_deg": 20.0},
})  # fmt: skip


@pytest.mark.parametrize("subvoxels", [2, 3])
def test_a_pattern_is_held_as_long_before_its_angle_as_after(subvoxels: int) -> None:
    """One pattern of eight, at azimuth 0: its light is alike on both sides of y = 0."""
    images = np.zeros((8, 60, 200), np.int64)
    images[0, :, 130:150] = 255
    upright = PARALLEL.model_copy(update={"projector": PARALLEL.need_projector().model_copy(update={"azimuth_deg": 0})})
    dose = dose_of_patterns(patterns_of(images), upright, Grid((2, 30, 30), 0.2), subvoxels=subvoxels)
    assert dose.any()
    np.testing.assert_allclose(dose, dose[:, ::-1], atol=1e-5 * float(dose.max()))


def test_white_patterns_without_vial_or_absorption_bring_one_constant() -> None:
    images = np.full((8, 60, 200), 255)
    grid = Grid((5, 20, 20), 0.2)
    for rig in (PARALLEL, printer_without_glass(0.0)):
        dose = dose_of_patterns(patterns_of(images, 0.01), rig, grid)
        np.testing.assert_allclose(dose[:, 5:15, 5:15], 2 * np.pi * 255 * 0.01, rtol=1e-4)


def test_dose_does_not_depend_on_the_blocks_in_which_it_is_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    # Blocks find the climb of light at places of their own: so close that what lies between does not matter.
    monkeypatch.setattr("vialight.planning.strips._CLIMB_A_KNOT", 0.03)
    rng = np.random.default_rng(1)
    patterns = patterns_of(rng.integers(0, 255, (12, 90, 200)))
    grid = Grid((17, 16, 16), 0.25)
    whole = dose_of_patterns(patterns, printer(), grid, subvoxels=2)
    monkeypatch.setattr("vialight.planning.scoring._RAYS_A_BLOCK", 30_000)
    np.testing.assert_allclose(dose_of_patterns(patterns, printer(), grid, subvoxels=2), whole, rtol=1e-4)


def test_the_light_of_a_single_pixel_is_kept() -> None:
    """One pixel, telecentric and unrefracted: level times area in every slice across the ray, wherever voxels lie."""
    images = np.zeros((1, 5, 41))
    images[0, 2, 27] = 200
    grid = Grid((9, 30, 30), 0.11, 0.03)
    dose = dose_of_patterns(patterns_of(images), printer_without_glass(0.0), grid, subvoxels=2)
    # Shown for all of a turn: over each circle about the axis the light is spread evenly, and summed over the voxels
    # that it crosses it is the pixel's area times the chord.
    s = (512 - 20 + 27 - 511.5) * 0.065
    r = np.hypot(grid.x_mm, grid.y_mm[:, None])
    radius = 1.5
    expected = 2 * np.pi * 200 * 0.065**2 * 2 * math.sqrt(radius**2 - s**2)
    found = dose[:, r < radius].sum(dtype=np.float64) * 0.11**3
    assert found == pytest.approx(expected, rel=0.02)
