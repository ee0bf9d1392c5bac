"""The twin in time: what it shows, receives, cures and records, with and without faults."""

from __future__ import annotations

import copy
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from twin.rigs import patterns_of
from vialight.core.arrays import Grid
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns
from vialight.twin import (
    Faults,
    Twin,
    TwinSettings,
    check_that_it_gels,
    dose_a_turn_mj_per_cm2,
    dose_of,
    find_rig,
    grid_round,
    load_resin,
    play,
)
from vialight.twin.poses import Pose, VialPose
from vialight.twin.sensor import Sensor, StrayLight

RIG, RESIN = find_rig("orth2022-190"), load_resin("DUDMA")
BRIGHT = RIG.model_copy(  # prints in a quarter of the time
    update={"projector": RIG.need_projector().model_copy(update={"irradiance_mw_per_cm2": 80.0})}
)
QUIET = TwinSettings(stray=StrayLight(0.0, 0.0), sensor=Sensor(read_noise_counts=0.0, electrons_per_count=1e6))
TURN_S = 18.0


def beam(half_width_mm: float, level: int, *, angles: int = 72, rows: int = 80, dose: float = 1.0) -> Patterns:
    """The silhouette of an upright cylinder: about `dose` a turn inside it."""
    images = np.zeros((angles, rows, 380), np.uint8)
    # Seen from the projector, resin at x lies at 1.49 x.
    images[:, :, np.abs(np.arange(380) - 189.5) * 0.065 < 1.49 * half_width_mm] = level
    return patterns_of(images, dose / (2 * np.pi * level * 0.6))


def printed(patterns: Patterns, turns: float, grid: Grid, settings: TwinSettings = QUIET, dark: float = 0.0) -> Twin:
    twin = Twin(BRIGHT, RESIN, grid, settings)
    for _ in play(twin, patterns, turns=turns, dark_turns=dark, frame_rate_hz=0.2):
        pass
    return twin


def test_a_turn_in_time_brings_the_dose_of_a_turn_of_patterns() -> None:
    patterns, grid = beam(3.0, 40), Grid((4, 30, 30), 0.3)
    twin = printed(patterns, 1.0, grid, replace(QUIET, blur_mm=0.0))
    expected = dose_of(patterns, twin.rig, grid, angles_a_pattern=5) * dose_a_turn_mj_per_cm2(patterns, twin)
    found = np.moveaxis(twin.dose_mj_per_cm2, 2, 0)
    assert np.abs(found - expected).mean() < 0.01 * expected.max()
    assert twin.time_s == pytest.approx(TURN_S)


@pytest.mark.parametrize("direction", [1, -1])
def test_a_place_is_lit_whichever_way_the_stage_turns(direction: Literal[1, -1]) -> None:
    """A beam that follows the place (2, 1) of the object, by hand: seen from the projector it lies at x_c."""
    grid, place, count = Grid((2, 30, 30), 0.2), (2.0, 1.0), 90
    theta = np.arange(count) * 2 * np.pi / count
    psi = theta + np.pi / 2  # the projector's azimuth is -90 degrees
    x_c = 1.49 * (place[0] * np.cos(psi) - place[1] * np.sin(psi))
    columns = (np.arange(300) - 149.5) * 0.065
    images = np.where(np.abs(columns - x_c[:, None]) < 0.3, 200, 0)[:, None, :].repeat(40, axis=1)
    rig = RIG.model_copy(update={"stage": RIG.stage.model_copy(update={"direction": direction})})
    twin = Twin(rig, RESIN, grid, QUIET)
    moments = list(play(twin, patterns_of(images), turns=1.0, dark_turns=0.0, frame_rate_hz=0.25))
    y, x, _ = np.unravel_index(np.argmax(twin.dose_mj_per_cm2), twin.dose_mj_per_cm2.shape)
    assert (grid.x_mm[x], grid.y_mm[y]) == pytest.approx(place, abs=0.25)
    angles = [moment.frame.angle_rad for moment in moments if moment.frame]
    assert (np.diff(angles) > 0).all()  # the stage counts upwards either way


def test_the_state_does_not_depend_on_how_time_is_cut() -> None:
    grid = Grid((4, 16, 16), 0.4)
    image = np.full((200, 400), 200, np.uint8)
    whole, cut = (Twin(RIG, RESIN, grid, QUIET) for _ in range(2))
    for twin, steps in ((whole, [6.0]), (cut, [0.3] * 20)):
        twin.show(image, (284, 312))
        for step in steps:
            twin.advance(step)
    np.testing.assert_allclose(whole.dose_mj_per_cm2, cut.dose_mj_per_cm2, rtol=0.02)
    np.testing.assert_allclose(whole.state.oxygen, cut.state.oxygen, rtol=0.01)


def test_a_copy_goes_on_as_the_original_would_and_leaves_it_alone() -> None:
    """What a sweep over stop times branches from: in mid-chemistry, with light on its way and noise to come."""
    image, grid = np.full((200, 400), 200, np.uint8), Grid((4, 16, 16), 0.4)
    settings = TwinSettings(binning=8, faults=Faults(dropped_share=0.2))
    twin, alone = (Twin(BRIGHT, RESIN, grid, settings) for _ in range(2))
    for each in (twin, alone):
        each.show(image, (284, 312))
        each.advance(3.3)
    branch, dark = copy.deepcopy(twin), copy.deepcopy(twin)
    frames = []
    for each in (branch, twin):
        each.show(image, (284, 312))
        each.advance(4.0)
        frames.append([each.frame() for _ in range(8)])
    np.testing.assert_array_equal(branch.dose_mj_per_cm2, twin.dose_mj_per_cm2)
    np.testing.assert_array_equal(branch.state.conversion, twin.state.conversion)
    assert [frame is None for frame in frames[0]] == [frame is None for frame in frames[1]]
    for one, other in zip(*frames, strict=True):
        assert one is None or (other is not None and np.array_equal(one.counts, other.counts))
    for each in (dark, alone):
        each.show(None)
        each.advance(4.0)
    np.testing.assert_array_equal(dark.dose_mj_per_cm2, alone.dose_mj_per_cm2)
    assert dark.dose_mj_per_cm2.sum() < 0.6 * twin.dose_mj_per_cm2.sum()


def test_the_light_goes_off_and_the_vial_turns_on() -> None:
    twin = Twin(RIG, RESIN, Grid((4, 20, 20), 0.4), QUIET)
    moments = list(play(twin, beam(3.0, 40), turns=0.5, dark_turns=0.5))
    assert [moment.is_lit for moment in moments] == [True] * 90 + [False] * 90
    frames = [moment.frame for moment in moments if moment.frame]
    np.testing.assert_allclose(np.degrees([frame.angle_rad for frame in frames]), np.arange(180) * 2.0, atol=1e-9)
    np.testing.assert_allclose([frame.time_s for frame in frames], np.arange(180) * 0.1, atol=1e-9)
    before, after = twin.dose_mj_per_cm2.copy(), twin
    after.advance(5.0)
    np.testing.assert_array_equal(before, after.dose_mj_per_cm2)


def test_a_cylinder_gels_where_its_light_was() -> None:
    patterns = beam(3.0, 60)
    corners = np.array([[-3, -3, -2], [3, -3, -2], [0, 3, -2], [0, 0, 2]], dtype=np.float64)
    part = Mesh(corners, np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]))
    grid = grid_round(part, 0.2, margin_mm=1.0)
    twin = printed(patterns, 5.3, grid, dark=1.0)
    assert np.isfinite(twin.gel_time_s).any()
    surface = twin.surface()
    assert surface.is_closed
    radius = np.hypot(*surface.vertices_mm[:, :2].T)[np.abs(surface.vertices_mm[:, 2]) < 1.0]
    assert 2.7 < np.median(radius) < 3.15
    heights = twin.height_map(set_down_at_mm=(0.3, 0.0))
    columns = np.flatnonzero(np.isfinite(heights).any(axis=0))
    assert (columns.mean() - (heights.shape[1] - 1) / 2) * 0.05 == pytest.approx(0.3, abs=0.06)
    assert np.isfinite(heights).any(axis=0).sum() * 0.05 == pytest.approx(2 * np.median(radius), abs=0.15)
    assert np.nanmax(heights) == pytest.approx(np.ptp(surface.vertices_mm[:, 2]), abs=0.1)
    assert np.nanmin(twin.gel_time_s) > TURN_S


def test_resin_that_cannot_gel_is_told_with_both_doses() -> None:
    patterns = beam(3.0, 5)
    twin = Twin(RIG, RESIN, Grid((8, 40, 40), 0.2), QUIET)
    with pytest.raises(InputError, match=r"cannot gel: it gets \d.* critical dose, 961.8"):
        check_that_it_gels(patterns, twin, 3.0)
    check_that_it_gels(patterns, twin, np.inf)
    dark = replace(patterns, levels=np.zeros_like(patterns.levels))
    with pytest.raises(InputError, match="it gets 0 mJ"):
        check_that_it_gels(dark, twin, np.inf)
    with pytest.raises(InputError, match="nothing has gelled"):
        twin.surface()


def test_faults_of_the_stage_move_object_and_vial() -> None:
    faults = Faults(axis_offset_mm=(0.1, -0.2), run_out_mm=0.05, tilt_rad=(0.01, 0.0))
    assert faults.pose(0.0) == Pose(0.0, (0.1, -0.2), (0.01, 0.0))
    assert faults.vial(0.0) == VialPose((0.15, -0.2), (0.01, 0.0))
    assert faults.pose_in_vial(0.0) == Pose(0.0, (-0.05, 0.0))
    ripple = Faults(speed_ripple=0.05)
    angles = np.array([ripple.angle(time, 1.0) for time in np.linspace(0, 2 * np.pi, 400)])
    speed = np.gradient(angles, np.linspace(0, 2 * np.pi, 400))
    assert speed.max() == pytest.approx(1.05, abs=2e-3)
    assert angles[-1] == pytest.approx(2 * np.pi)


def test_faults_of_the_camera_show_in_its_frames() -> None:
    grid = Grid((8, 40, 40), 0.2)
    faults = Faults(dropped_share=0.3, timestamp_jitter_s=0.01, led_drift_per_s=-0.02, specks=30)
    settings = replace(QUIET, stray=StrayLight(100.0, 0.0), faults=faults)
    twin = Twin(RIG, RESIN, grid, settings)
    moments = list(play(twin, beam(3.0, 1), turns=0.5, dark_turns=0.0))
    frames = [moment.frame for moment in moments if moment.frame]
    assert 0.5 < len(frames) / len(moments) < 0.9
    late = np.array([frame.time_s for frame in frames])
    assert 0.002 < np.std(np.mod(late + 0.05, 0.1)) < 0.03
    corner = [float(frame.counts[0, 0]) for frame in frames]
    assert corner[-1] / corner[0] == pytest.approx(1 - 0.02 * 9, abs=0.02)
    assert frames[0].counts.max() > 110  # specks scatter before anything has cured


def test_a_dimmed_or_shifted_projector_is_one() -> None:
    patterns, grid = beam(2.0, 40), Grid((4, 40, 40), 0.2)
    plain = printed(patterns, 1.0, grid)
    dimmed = printed(patterns, 1.0, grid, replace(QUIET, faults=Faults(projector_gain=0.5)))
    np.testing.assert_allclose(dimmed.dose_mj_per_cm2, plain.dose_mj_per_cm2 / 2, rtol=1e-5)
    shifted = printed(patterns, 1.0, grid, replace(QUIET, faults=Faults(projector_shift_pixels=(15.0, 0.0))))
    # 15 pixels of 0.065 mm, over 1.49: light from -1.35 to 2.65 mm, which leaves the rim dark for part of the turn.
    radius = np.hypot(grid.x_mm, grid.y_mm[:, None])
    for low, high, share in ((0.0, 1.1, 1.0), (1.6, 1.8, 0.79)):
        ring = (radius >= low) & (radius < high)
        ratio = shifted.dose_mj_per_cm2[ring].mean() / plain.dose_mj_per_cm2[ring].mean()
        assert ratio == pytest.approx(share, abs=0.05)


def test_shrinking_resin_makes_a_smaller_part() -> None:
    grid = Grid((8, 40, 40), 0.2)
    patterns = beam(2.0, 60)
    plain = printed(patterns, 5.5, grid)
    shrinking = load_resin("DUDMA")
    shrinking = replace(shrinking, chemistry=replace(shrinking.chemistry, linear_shrinkage=0.1))
    twin = Twin(BRIGHT, shrinking, grid, QUIET)
    twin.state, twin.gel_time_s = plain.state, plain.gel_time_s
    ratio = twin.surface().extents_mm / plain.surface().extents_mm
    conversion = plain.state.conversion[np.isfinite(plain.gel_time_s)].mean()
    np.testing.assert_allclose(ratio, 1 - 0.1 * conversion, rtol=1e-5)


def test_the_shown_image_glows_where_it_is_and_fades_with_depth() -> None:
    twin = Twin(RIG, RESIN, Grid((20, 40, 40), 0.4), QUIET)
    image = np.zeros((101, 401), np.uint8)
    image[30:40] = 255  # a sheet of light, seen from its side
    twin.show(image, (334, 311))
    frame = twin.fluorescence(100.0).astype(float)
    rows = (59.5 - np.arange(120)) * 0.155
    line = frame[:, 60:115].sum(axis=1)
    assert (line * rows).sum() / line.sum() == pytest.approx((383.5 - 368.5) * 0.065, abs=0.1)
    # The light comes from the left, and loses a factor of e every 12.5 mm of resin.
    left, right = frame[:, 70].sum(), frame[:, 105].sum()
    assert left > 1.1 * right
    twin.show(None)
    assert not twin.fluorescence(100.0).any()


def test_a_rig_without_irradiance_is_refused() -> None:
    projector = RIG.need_projector().model_copy(update={"irradiance_mw_per_cm2": None})
    with pytest.raises(InputError, match="irradiance_mw_per_cm2"):
        Twin(RIG.model_copy(update={"projector": projector}), RESIN, Grid((2, 2, 2), 1.0))
    with pytest.raises(InputError, match="dropped_share"):
        Faults(dropped_share=2.0)
