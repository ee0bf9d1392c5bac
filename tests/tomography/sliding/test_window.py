"""The live volume: against fresh reconstructions of the same frames, whatever order and state they come in."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

from vialight.core.arrays import Float32Array, FloatArray, Grid, ParallelBeam, Volume
from vialight.core.config import Camera, Resin, Rig, RunOut, Stage, Vial
from vialight.core.errors import InputError
from vialight.metrology.distance import deviation, sample_surface
from vialight.metrology.surface import isosurface
from vialight.optics.refraction import camera_to_virtual
from vialight.store import open_frames, write_frames
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.tomography.radon import ramp_filter
from vialight.tomography.radon.updating import add_projections
from vialight.tomography.reconstruct import Settings, open_scan, reconstruct
from vialight.tomography.sinogram import resample, resampling
from vialight.tomography.sliding.window import SlidingWindow
from vialight.tomography.volume import DEFAULT_FILTER

ROWS, COLUMNS, FRAMES = 20, 88, 60
STEP = 2 * np.pi / FRAMES
VOXEL_MM = 0.35
THRESHOLD = 60.0
RIG = Rig(
    vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
    resin=Resin(index_imaging=1.48),
    camera=Camera(distance_mm=190.0, pixel_mm=0.31, axis_column=43.2, optical_row=9.3),
)
DARK = np.full((ROWS, COLUMNS), 30.0) + np.arange(COLUMNS)
TOLERANCE = 1e-4
"""Of the largest density: what the issue asks for."""


def frame(angle_rad: float, brightness: float = 1.0, rig: Rig = RIG) -> Float32Array:
    """Photograph three balls of Gaussian density over stray light."""
    camera, optics = rig.need_camera(), rig.imaging_optics()
    assert optics is not None
    x_c = (np.arange(COLUMNS, dtype=np.float64) - camera.axis_column) * camera.pixel_mm
    z_c = ((camera.optical_row - np.arange(ROWS, dtype=np.float64)) * camera.pixel_mm)[:, None]
    rays = camera_to_virtual(x_c, z_c, optics)
    psi = angle_rad + rays.direction_rad
    counts = np.zeros((ROWS, COLUMNS))
    for x, y, z, sigma, density in (
        (2.9, -1.8, 0.5, 1.1, 150.0),
        (-3.0, 2.0, -0.6, 0.9, 110.0),
        (0.2, 4.9, 0.2, 0.8, 90.0),
    ):
        across = x * np.cos(psi) - y * np.sin(psi) - rays.virtual_x_mm
        above = z - rays.mid_height_mm - rays.slope * (x * np.sin(psi) + y * np.cos(psi))
        counts += density * sigma * np.sqrt(2 * np.pi) * np.exp(-(across**2 + above**2) / (2 * sigma**2))
    return (brightness * np.nan_to_num(counts) + DARK).astype(np.float32)


def window(rig: Rig = RIG, **options: object) -> SlidingWindow:
    settings = {"dark": DARK, "threshold": THRESHOLD, "voxel_mm": VOXEL_MM} | options
    return SlidingWindow(rig, (ROWS, COLUMNS), FRAMES, **settings)  # type: ignore[arg-type]


def fill(made: SlidingWindow, angles_rad: FloatArray, brightness: FloatArray | None = None) -> SlidingWindow:
    """Feed frames, renewing the volume after each."""
    brightness = np.ones(len(angles_rad)) if brightness is None else brightness
    for angle, bright in zip(angles_rad, brightness, strict=True):
        made.add(frame(angle, bright), angle)
        made.renew()
    return made


def turn(first: float = 0.3, count: int = FRAMES) -> FloatArray:
    return np.asarray(first + np.arange(count) * STEP, dtype=np.float64)


def fresh(sinogram: Float32Array, beam: ParallelBeam, grid: Grid) -> FloatArray:
    """Filter and backproject a sinogram plainly, in double precision."""
    matrix = ramp_filter(DEFAULT_FILTER, len(beam.virtual_x_mm), beam.spacing_mm).astype(np.float64)
    volume = np.zeros(grid.shape)
    for psi, rays in zip(beam.psi_rad, sinogram, strict=True):
        filtered = matrix @ rays
        at = (grid.x_mm * np.cos(psi) - grid.y_mm[:, None] * np.sin(psi) - beam.virtual_x_mm[0]) / beam.spacing_mm
        index = np.clip(at.astype(int), 0, len(filtered) - 2)
        weight = (at - index)[..., None]
        value = filtered[index] * (1 - weight) + filtered[index + 1] * weight
        value[(at < 0) | (at > len(filtered) - 1)] = 0
        volume += value.transpose(2, 0, 1)
    volume *= np.pi / len(beam.psi_rad)
    field = RIG.imaging_optics().field_radius_mm  # type: ignore[union-attr]
    return np.where(np.hypot(grid.x_mm, grid.y_mm[:, None]) <= field, volume, 0)


@dataclass(frozen=True)
class Arrivals:
    """Frames as they come: angle and brightness, which grows as a print does."""

    angles_rad: FloatArray
    brightness: FloatArray


def troubled(turns: int, seed: int = 0) -> Arrivals:
    """Return frames whose angles do not repeat, with jitter; 5 % are lost, 5 % come up to four frames late."""
    rng = np.random.default_rng(seed)
    number = np.arange(turns * FRAMES)
    angles = 0.3 + number * STEP * 1.0037 + rng.uniform(-0.25, 0.25, len(number)) * STEP
    brightness = 0.2 + number / len(number) + 0.1 * rng.random(len(number))
    arrival = number + np.where(rng.random(len(number)) < 0.05, rng.integers(1, 5, len(number)) + 0.5, 0)
    kept = np.argsort(arrival)
    kept = kept[rng.random(len(kept)) > 0.05]
    return Arrivals(angles[kept], brightness[kept])


@pytest.fixture(scope="module")
def after_twenty_turns() -> SlidingWindow:
    arrivals = troubled(20)
    return fill(window(), arrivals.angles_rad, arrivals.brightness)


def test_after_20_troubled_turns_the_volume_is_that_of_its_rows(after_twenty_turns: SlidingWindow) -> None:
    made = after_twenty_turns
    made.renew(everything=True)
    expected = fresh(made.sinogram, made.beam, made.grid)
    assert expected.max() > 100
    assert np.abs(made.volume - expected).max() < TOLERANCE * expected.max()


def test_its_rows_are_those_that_resample_reads_off_the_last_turn(
    after_twenty_turns: SlidingWindow, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The window is told the step between frames, which decides what a gap is; `resample` takes the median.
    monkeypatch.setattr(resampling, "nominal_step", lambda _: STEP)
    made, arrivals = after_twenty_turns, troubled(20)
    newest = arrivals.angles_rad.max()
    last = np.flatnonzero(arrivals.angles_rad >= newest - 2 * np.pi + STEP / 2)
    angles = arrivals.angles_rad[last]
    frames = np.stack([frame(a, b) - DARK for a, b in zip(angles, arrivals.brightness[last], strict=True)])
    expected = resample(
        frames.astype(np.float32), 0, angles, RIG.need_camera(), RIG.imaging_optics(), made.beam, made.grid.z_mm
    )
    np.testing.assert_allclose(made.sinogram, expected, rtol=0, atol=1e-5 * expected.max())


def test_sums_are_those_of_the_volume(after_twenty_turns: SlidingWindow) -> None:
    made = after_twenty_turns
    state, volume, voxel = made.renew(everything=True), made.volume, made.grid.voxel_mm
    cured = volume > THRESHOLD
    assert 20 < state.cured_volume_mm3 == pytest.approx(np.count_nonzero(cured) * voxel**3, rel=1e-9)
    for axis, name in enumerate(("xy", "xz", "yz")):
        density = voxel * volume.sum(axis=axis, dtype=np.float64)
        np.testing.assert_allclose(getattr(state.density, name), density, rtol=0, atol=1e-6 * np.abs(density).max())
        np.testing.assert_allclose(getattr(state.cured, name), voxel * cured.sum(axis=axis), rtol=1e-6)


@pytest.mark.parametrize("binning", [1, 2])
@pytest.mark.parametrize("direction", [1, -1])
def test_a_turn_of_a_still_object_is_what_the_pipeline_makes_of_it(
    direction: Literal[1, -1], binning: int, tmp_path: Path
) -> None:
    assert_as_the_pipeline_makes_it(RIG.model_copy(update={"stage": Stage(direction=direction)}), binning, tmp_path)


def test_a_tilted_axis_and_a_run_out_are_straightened_as_in_the_pipeline(tmp_path: Path) -> None:
    # In line with the camera at angle 0, so that both begin with the same virtual angle.
    stage = Stage(run_out=RunOut(radius_mm=0.2, phase_deg=90.0))
    camera = RIG.need_camera().model_copy(update={"axis_tilt_deg": 0.8})
    assert_as_the_pipeline_makes_it(RIG.model_copy(update={"stage": stage, "camera": camera}), 1, tmp_path)


def assert_as_the_pipeline_makes_it(rig: Rig, binning: int, folder: Path) -> None:
    direction = rig.stage.direction
    # Virtual angles begin at 0 in the window, in the pipeline with the first frame.
    angles = turn(0.0)
    counts = np.stack([np.rint(50 * frame(angle)) for angle in angles]).astype(np.uint16)
    dark = np.rint(50 * DARK).astype(np.uint16)
    write_frames(folder / "f.h5", counts, direction * angles, dark=dark)
    settings = Settings(voxel_mm=VOXEL_MM * binning, binning=binning)
    made = window(rig, dark=dark, voxel_mm=settings.voxel_mm, binning=binning)
    for image, angle in zip(counts, direction * angles, strict=True):
        assert made.add(image, float(angle))
    made.renew(everything=True)
    with open_frames(folder / "f.h5") as frames:
        expected = reconstruct(open_scan(frames, rig, settings), settings)
    assert made.grid == expected.grid
    assert np.abs(made.volume - expected.density).max() < TOLERANCE * expected.density.max()


def settled(angles_rad: FloatArray, brightness: FloatArray | None = None, rig: Rig = RIG) -> Float32Array:
    """Return the volume once everything is in."""
    made = fill(window(rig), angles_rad, brightness)
    made.renew(everything=True)
    return made.volume


def assert_same(volume: Float32Array, expected: Float32Array, tolerance: float = TOLERANCE) -> None:
    assert expected.max() > 100
    assert np.abs(volume - expected).max() < tolerance * expected.max()


def test_frames_in_any_order_give_the_same_volume_as_frames_in_order() -> None:
    angles, brightness = turn(0.3, 2 * FRAMES), np.linspace(0.5, 1.5, 2 * FRAMES)
    shuffled = np.argsort(np.arange(len(angles)) + np.random.default_rng(1).uniform(0, 8, len(angles)))
    assert (np.diff(shuffled) < 0).sum() > 20
    assert_same(settled(angles[shuffled], brightness[shuffled]), settled(angles, brightness))


def test_a_stage_that_turns_the_other_way_gives_the_same_volume() -> None:
    angles, brightness = turn(0.3, 2 * FRAMES), np.linspace(0.5, 1.5, 2 * FRAMES)
    backwards = fill(window(), -angles, brightness)
    backwards.renew(everything=True)
    rows = fill(window(), -angles[-FRAMES:], brightness[-FRAMES:])
    rows.renew(everything=True)
    assert_same(backwards.volume, rows.volume)
    assert_same(settled(-turn()), settled(turn()), 0.02)


def test_angles_that_begin_anew_with_each_turn_do_as_well() -> None:
    angles, brightness = turn(0.3, 3 * FRAMES), np.linspace(0.5, 1.5, 3 * FRAMES)
    made = window()
    for angle, bright in zip(angles, brightness, strict=True):
        made.add(frame(angle, bright), angle % (2 * np.pi))
    made.renew(everything=True)
    assert_same(made.volume, settled(angles, brightness))


def test_duplicates_change_nothing() -> None:
    angles = turn()
    made = fill(window(), angles)
    before = made.renew(everything=True)
    volume = made.volume.copy()
    for angle in np.r_[angles[-1], angles[-1], angles[40:50]]:
        made.add(frame(angle), angle)
    again = made.renew(everything=True)
    assert_same(made.volume, volume, 1e-6)
    assert again.frames_in_turn == before.frames_in_turn == FRAMES
    assert again.cured_volume_mm3 == before.cured_volume_mm3


def test_frames_between_frames_and_a_turn_late_are_left_out() -> None:
    angles = turn(0.3, 2 * FRAMES)
    made = fill(window(), angles)
    assert not made.add(frame(angles[70] + STEP / 5), angles[70] + STEP / 5)
    assert not made.add(frame(angles[20]), angles[20])
    state = made.renew()
    assert (state.frames_used, state.frames_in_turn) == (2 * FRAMES, FRAMES)


def test_a_new_turn_replaces_the_old_one() -> None:
    angles = turn(0.3, 2 * FRAMES)
    brightness = np.repeat([1.0, 3.0], FRAMES)
    assert_same(settled(angles, brightness), 3 * settled(angles[:FRAMES]))


def test_half_a_turn_and_the_skew_see_every_ray() -> None:
    """The opposite of a ray not seen yet stands for it."""
    made = window()
    never, volumes = [], []
    for angle in turn():
        made.add(frame(angle), angle)
        never.append(made.renew().never_share)
        volumes.append(made.volume.copy())
    assert never[0] > 0.9
    assert never == sorted(never, reverse=True)
    seen_all = never.index(0.0)
    assert 180 < np.degrees(seen_all * STEP) < 180 + 2 * 42 + 12
    made.renew(everything=True)
    assert_same(volumes[seen_all + 3], made.volume, 0.03)


def test_what_is_provisional_is_the_skew_while_a_stage_turns() -> None:
    """The outermost ray is skewed by 35.4 deg: angles up to that ahead, and as much and 1.5 steps behind, are passing.

    To within an angle, and one more ahead, whose cubic reaches to the new frame.
    """
    made = window()
    for number, angle in enumerate(turn(0.3, 2 * FRAMES)):
        made.add(frame(angle, 1 + 0.01 * number), angle)
        state = made.renew()
    assert state.incomplete_share == state.provisional_share
    assert state.provisional_share == pytest.approx((2 * 35.4 + 9) / 360, abs=2 / FRAMES)
    assert state.older_share == state.never_share == 0
    on_axis, at_half, complete = np.degrees(made.lags_rad)
    assert on_axis == pytest.approx(0, abs=0.3)
    assert at_half == pytest.approx(8, abs=1)
    assert complete == pytest.approx(35.4 + 9, abs=0.1)


def test_a_gap_is_seen_from_the_other_side() -> None:
    angles = turn(0.3, 2 * FRAMES)
    missing = np.r_[0:80, 87:120]  # 48 deg without a frame in the second turn
    made = fill(window(), angles[missing])
    state = made.renew(everything=True)
    assert state.older_share == state.never_share == 0
    assert_same(made.volume, settled(turn()), 0.03)


def test_where_no_side_sees_the_old_turns_values_stay() -> None:
    angles = turn(0.3, 3 * FRAMES)
    made = fill(window(), np.r_[angles[:70], angles[125:135]])
    state = made.renew(everything=True)
    assert 0.2 < state.older_share < 1
    assert state.never_share == 0
    assert_same(made.volume, settled(turn()), 0.03)


@pytest.mark.parametrize("seed", [1, 2])
def test_most_frames_cost_three_angles(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """A frame changes a few columns of 17 of 60 angles."""
    counts: list[int] = []

    def spy(volume: Float32Array, filtered: Float32Array, *others: Any) -> Any:
        counts.append(len(filtered))
        return add_projections(volume, filtered, *others)

    monkeypatch.setattr("vialight.tomography.sliding.window.add_projections", spy)
    arrivals = troubled(4, seed)
    fill(window(), arrivals.angles_rad, arrivals.brightness)
    assert len(counts) > 0.9 * len(arrivals.angles_rad)
    assert np.mean(counts) < 4
    assert np.median(counts) == 3


def test_no_frame_waits_for_a_compiler_once_kernels_are_compiled() -> None:
    """Seen from a process of its own, where nothing has run before."""
    script = Path(__file__).with_name("kernels_that_compile_late.py")
    told = subprocess.run([sys.executable, script], check=True, capture_output=True, text=True)
    assert told.stdout == "known: 6, new: 0\n"


def test_the_streamed_sample_is_true_to_12_um(shared_cases: Path) -> None:
    """RMS in um: 10.1, as of the whole turn at once."""
    folder = shared_cases / "part"
    with open_frames(folder / "frames.h5") as frames:
        counts, angles, dark = frames.read(slice(None)), frames.angles_rad, frames.dark()
    made = SlidingWindow(load_rig(folder / "rig.toml"), counts.shape[1:], 180, dark=dark, threshold=100.0)
    # A second turn of the same frames, begun and not ended: nothing that has come may be missing.
    for number in range(180 + 50):
        made.add(counts[number % 180], angles[number % 180] + number // 180 * 2 * np.pi)
        state = made.renew()
    surface = isosurface(Volume(np.ascontiguousarray(made.volume), made.grid), 100.0)
    found = deviation(sample_surface(surface, 30_000), load_mesh(folder / "truth.stl"))
    assert found.rmse_mm <= 0.012
    assert state.cured_volume_mm3 == pytest.approx(surface.volume_mm3, rel=0.01)


@pytest.mark.parametrize(
    ("shape", "frames", "options", "says"),
    [
        ((ROWS, COLUMNS), 61, {}, "frames per turn: 61; accepted: an even number"),
        ((ROWS, COLUMNS), 2, {}, "frames per turn: 2"),
        ((ROWS, COLUMNS), 60, {"binning": 30}, "--bin: is 30 for 20 x 88 pixels"),
        ((ROWS, COLUMNS + 1), 60, {}, "dark frame: has shape"),
    ],
)
def test_what_does_not_fit_is_refused(shape: tuple[int, int], frames: int, options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says):
        SlidingWindow(RIG, shape, frames, dark=DARK, threshold=1.0, **options)


def test_a_frame_of_another_shape_or_without_an_angle_is_refused() -> None:
    made = window()
    with pytest.raises(InputError, match="frame: has shape"):
        made.add(DARK[1:], 0.0)
    with pytest.raises(InputError, match="angle nan"):
        made.add(DARK, np.nan)
