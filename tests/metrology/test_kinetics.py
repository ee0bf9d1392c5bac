"""Dose over time against the judge of plans, gel times, and failures put there on purpose."""

from __future__ import annotations

import numpy as np
import pytest

from printing.prints import quick_rig
from twin.rigs import patterns_of
from vialight.core.arrays import FloatArray, Grid
from vialight.core.plan import Patterns
from vialight.metrology.kinetics import (
    InsideHistory,
    ShownPatterns,
    dose_over_time,
    mj_per_cm2,
    outside_failures,
    stalled_failures,
)
from vialight.planning.scoring import dose_of_patterns

THRESHOLD = 100.0
TURN_S, LOOKS = 18.0, 12


def uneven_patterns() -> Patterns:
    """Light that differs by row, column and angle, smooth on the scale of a voxel."""
    angle, row, column = np.meshgrid(np.arange(90), np.arange(200), np.arange(300), indexing="ij")
    wave = np.sin(angle * np.pi / 45 + 1) * np.sin(row / 40) + np.cos(column / 30 + angle * np.pi / 90)
    return patterns_of((100 + 45 * wave).astype(np.uint8))


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (3.0, 1.5, 1.2), (-1.5, -3.3, -2.4)])
def test_dose_of_a_turn_is_that_of_the_judge(at: tuple[float, float, float]) -> None:
    patterns, rig = uneven_patterns(), quick_rig()
    grid = Grid((17, 30, 30), 0.3)
    judged = dose_of_patterns(patterns, rig, grid, subvoxels=1)
    k = [int(np.abs(axis - value).argmin()) for axis, value in zip((grid.z_mm, grid.y_mm, grid.x_mm), at[::-1],
                                                                  strict=True)]  # fmt: skip
    point = np.array([[grid.x_mm[k[2]], grid.y_mm[k[1]], grid.z_mm[k[0]]]])
    speed = np.radians(rig.stage.speed_deg_s)
    step_s = patterns.step_rad / speed
    time_s = (np.arange(91) - 0.5) * step_s
    pattern = np.append(np.arange(90), -1)
    dose = dose_over_time(point, patterns, rig, ShownPatterns(time_s, pattern, np.append(patterns.angles_rad, 0.0)))
    assert dose[0] == 0
    assert (np.diff(dose) >= 0).all()
    assert dose[-1] == pytest.approx(float(judged[tuple(k)]), rel=0.02)


def test_black_brings_no_dose_and_a_dose_has_its_unit() -> None:
    patterns, rig = uneven_patterns(), quick_rig()
    shown = ShownPatterns(np.array([0.0, 1.0, 3.0, 4.0]), np.array([0, -1, 0, -1]), np.zeros(4))
    dose = dose_over_time(np.zeros((1, 3)), patterns, rig, shown)
    assert dose[1] == dose[2]
    assert dose[3] == pytest.approx(2 * dose[1])
    unit = mj_per_cm2(patterns, rig)
    assert unit is not None
    irradiance = rig.need_projector().irradiance_mw_per_cm2
    assert irradiance is not None
    # On the axis, one second of level g brings g/255 of the irradiance, times what the vial makes of it.
    assert 0.2 < unit * dose[1] / (irradiance * float(patterns.levels[0, 95:105, 145:155].mean()) / 255) < 1.6


def test_what_gels_outside_is_told_with_its_first_moment_and_final_size() -> None:
    grid = Grid((20, 20, 20), 0.2)
    times = np.full(grid.shape, np.nan, np.float32)
    times[8:12, 8:12, 8:12] = 50.0  # inside
    times[2:5, 2:5, 2:5] = 100.0
    times[2:5, 2:5, 5:8] = 130.0
    times[15, 15, 15] = 10.0  # a speck
    outside = np.ones(grid.shape, np.bool_)
    outside[7:13, 7:13, 7:13] = False
    (found,) = outside_failures(times, grid, outside, 0.2)
    assert found.time_s == 100.0
    assert found.size_mm3 == pytest.approx(54 * 0.008)
    np.testing.assert_allclose(found.at_mm, [grid.x_mm[3], grid.y_mm[3], grid.z_mm[3]])


def history_of(rate: FloatArray, stops_at_s: FloatArray, *, lit_s: float = 180.0) -> InsideHistory:
    """Cubes in a row, each growing evenly until it stops; what is seen is the mean of the turn before."""
    time_s = np.arange(1, 20 * LOOKS + 1, dtype=np.float64) * (TURN_S / LOOKS)
    fine = np.linspace(-TURN_S, time_s[-1], 4000)[:, None]
    true = rate * np.clip(fine, 0, np.minimum(stops_at_s, lit_s))
    integral = np.concatenate([np.zeros((1, len(rate))), np.cumsum(true[1:] * np.diff(fine, axis=0), axis=0)])
    density = np.stack(
        [
            (np.interp(time_s, fine[:, 0], one) - np.interp(time_s - TURN_S, fine[:, 0], one)) / TURN_S
            for one in integral.T
        ],
        axis=1,
    )
    noise = np.random.default_rng(0).normal(0, 0.4, density.shape)
    cells = np.stack([np.zeros(len(rate)), np.zeros(len(rate)), np.arange(len(rate))], axis=1).astype(np.int64)
    return InsideHistory(
        cells,
        np.asarray(cells[:, ::-1] * 0.5, np.float64),
        0.5,
        (density + noise).astype(np.float32),
        time_s,
        np.minimum(time_s, np.float64(lit_s)),
        LOOKS,
    )


def test_a_region_that_stopped_gaining_is_found_where_and_when_it_did() -> None:
    stops = np.full(40, np.inf)
    stops[10:16] = 70.0
    found = stalled_failures(history_of(np.full(40, 1.0), stops), THRESHOLD, 0.3)
    assert [one.what for one in found] == ["stopped gaining"]
    assert found[0].time_s == pytest.approx(70, abs=4)
    assert 5.0 <= found[0].at_mm[0] <= 7.5
    assert found[0].size_mm3 == pytest.approx(6 * 0.125)


def test_a_region_that_never_gained_is_found() -> None:
    rate = np.full(40, 1.0)
    rate[30:] = 0.0
    (found,) = stalled_failures(history_of(rate, np.full(40, np.inf)), THRESHOLD, 0.3)
    assert found.what == "never gained"
    assert found.at_mm[0] > 14.5


def test_a_region_that_gelled_and_went_away_is_found() -> None:
    history = history_of(np.full(40, 1.0), np.full(40, np.inf))
    history.density[200:, 5:10] = 3.0
    (found,) = stalled_failures(history, THRESHOLD, 0.3)
    assert found.what == "gelled and was lost"
    assert found.time_s == pytest.approx(history.time_s[199], abs=2)


@pytest.mark.parametrize("lit_s", [60.0, 110.0, 180.0])
def test_a_print_that_only_ends_early_or_late_has_not_failed(lit_s: float) -> None:
    rate = np.linspace(0.7, 1.2, 40)
    assert stalled_failures(history_of(rate, np.full(40, np.inf), lit_s=lit_s), THRESHOLD, 0.3) == []
