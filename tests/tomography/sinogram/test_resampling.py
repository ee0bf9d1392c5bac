"""Reading rays off frames, against bodies whose line integrals are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from vialight.core.arrays import Float32Array, FloatArray, ParallelBeam
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError
from vialight.optics.refraction import camera_to_virtual
from vialight.optics.viewing import ray_tilt
from vialight.tomography.sinogram import parallel_beam, resample

OPTICS = Optics(12.4, 11.3, 1.6, 1.48, 190.0)
SIGMA = 0.7
CENTRE_XY = (3.1, -2.4)
"""Of a ball of Gaussian density: off the axis."""

HEIGHT = 2.2
"""Of the ball above the optical axis, where rays climb 0.8 %; at 0, opposite views see the same."""

Z_MM = HEIGHT + 0.1 * np.arange(-2.0, 3.0)
ROWS, COLUMNS = 60, 176


def camera_at(axis_column: float) -> Camera:
    return Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=axis_column, optical_row=40.3)


def ball(
    psi: FloatArray, virtual_x: FloatArray, mid_height: FloatArray, slope: FloatArray, height: float = HEIGHT
) -> FloatArray:
    """Integrals over a Gaussian ball, of height 1, along rays in the resin: sqrt(2 pi) sigma exp(-d^2 / 2 sigma^2)."""
    norm = np.sqrt(1 + slope**2)
    direction = np.stack(np.broadcast_arrays(np.sin(psi) / norm, np.cos(psi) / norm, slope / norm))
    point = np.stack(np.broadcast_arrays(virtual_x * np.cos(psi), -virtual_x * np.sin(psi), mid_height))
    centre = np.array([*CENTRE_XY, height]).reshape(3, *[1] * (direction.ndim - 1))
    along = ((centre - point) * direction).sum(axis=0)
    squared = ((centre - point) ** 2).sum(axis=0) - along**2
    return np.asarray(np.sqrt(2 * np.pi) * SIGMA * np.exp(-squared / (2 * SIGMA**2)))


def frames_of_ball(
    angles: FloatArray, camera: Camera, optics: Optics | None = OPTICS, height: float = HEIGHT
) -> Float32Array:
    x_c = (np.arange(COLUMNS, dtype=np.float64) - camera.axis_column) * camera.pixel_mm
    z_c = ((camera.optical_row - np.arange(ROWS, dtype=np.float64)) * camera.pixel_mm)[:, None]
    if optics is None:
        return ball(angles[:, None, None], x_c, z_c, np.zeros(1), height).astype(np.float32)
    rays = camera_to_virtual(x_c, z_c, optics)
    counts = ball(angles[:, None, None] + rays.direction_rad, rays.virtual_x_mm, rays.mid_height_mm, rays.slope, height)
    return np.nan_to_num(counts).astype(np.float32)  # beside the vial it is dark


def sinogram_of_ball(beam: ParallelBeam, optics: Optics | None = OPTICS, height: float = HEIGHT) -> FloatArray:
    """(psi, x_v, z): the integrals along the plan view of rays."""
    z_mm = Z_MM - HEIGHT + height
    tilt = np.zeros((len(beam.virtual_x_mm), 1)) if optics is None else ray_tilt(beam.virtual_x_mm, optics)[:, None]
    slope = np.asarray(tilt * z_mm)
    integrals = ball(beam.psi_rad[:, None, None], beam.virtual_x_mm[:, None], z_mm, slope, height)
    if optics is not None:
        integrals[:, np.abs(beam.virtual_x_mm) > 0.9995 * optics.field_radius_mm] = 0
    return np.asarray(integrals / np.sqrt(1 + slope**2))


def error_of(
    angles: FloatArray, axis_column: float = 87.9, optics: Optics | None = OPTICS, height: float = HEIGHT
) -> FloatArray:
    """Resampled less true sinogram, in parts of the largest integral."""
    camera, z_mm = camera_at(axis_column), Z_MM - HEIGHT + height
    beam = parallel_beam(angles, COLUMNS, camera, optics)
    frames = frames_of_ball(angles, camera, optics, height)
    found = resample(frames, 0, angles, camera, optics, beam, z_mm)
    return np.asarray((found - sinogram_of_ball(beam, optics, height)) / (np.sqrt(2 * np.pi) * SIGMA))


def turn(count: int = 180, first_deg: float = 17.0) -> FloatArray:
    return np.asarray(np.radians(first_deg + np.arange(count) * (360.0 / count)), dtype=np.float64)


def scattered(angles: FloatArray, share: float = 0.1) -> FloatArray:
    """Leave out a share of frames by chance, some of them neighbours."""
    return np.delete(angles, np.random.default_rng(7).choice(len(angles), int(share * len(angles)), replace=False))


def gap(angles: FloatArray, at_deg: float, width_deg: float) -> FloatArray:
    away = np.abs((np.degrees(angles) - at_deg + 180) % 360 - 180)
    return angles[away > width_deg / 2]


@pytest.mark.parametrize("optics", [OPTICS, None])
@pytest.mark.parametrize("axis", [87.9, 87.5, 87.0, 91.31])
@pytest.mark.parametrize("count", [180, 181])
def test_the_sinogram_behind_the_vial_is_recovered(count: int, axis: float, optics: Optics | None) -> None:
    error = error_of(turn(count), axis, optics)
    assert np.abs(error).max() < 5e-4
    assert np.sqrt(np.mean(error**2)) < 1e-4


@pytest.mark.parametrize(
    ("angles", "largest"),
    [
        pytest.param(turn()[::-1], 5e-4, id="falling"),
        pytest.param(np.random.default_rng(1).permutation(turn()), 5e-4, id="any order"),
        pytest.param(np.concatenate([turn(), turn()[20:40]]), 5e-4, id="double"),
        pytest.param(turn() + 4 * np.pi, 5e-4, id="a later turn"),
        pytest.param(turn() + np.radians(np.random.default_rng(2).uniform(-0.5, 0.5, 180)), 5e-4, id="jitter"),
        pytest.param(np.radians(np.cumsum(2 + 0.5 * np.sin(turn()))), 5e-4, id="uneven speed"),
        pytest.param(scattered(turn()), 0.08, id="10 % missing"),
        pytest.param(scattered(turn() + np.radians(np.random.default_rng(2).uniform(-0.5, 0.5, 180))), 0.08,
                     id="10 % missing and jitter"),
        pytest.param(gap(turn(), 100, 15), 0.08, id="gap"),
        pytest.param(gap(turn(), 0, 15), 0.08, id="gap at the seam"),
        pytest.param(gap(turn(first_deg=0), 352, 15), 0.08, id="gap at the end"),
        pytest.param(gap(turn(), 52, 29), 0.08, id="widest gap"),
    ],
)  # fmt: skip
def test_uneven_missing_and_double_frames_do_no_harm(angles: FloatArray, largest: float) -> None:
    """Rays of missing frames come from the opposite side, or from a frame up to 1 deg off, where the ball is 4 % of its
    width away; they are few, and the root mean square is that of all rays."""
    error = error_of(angles)
    assert np.abs(error).max() < largest
    assert np.sqrt(np.mean(error**2)) < largest / (5 if largest < 0.01 else 20)


@pytest.mark.parametrize("axis", [82.0, 40.0, 95.0, 140.0])
def test_the_side_that_the_image_cuts_off_is_read_from_the_opposite_views(axis: float) -> None:
    error = error_of(turn(), axis)
    assert np.abs(error).max() < 0.02


def test_a_turn_may_begin_at_any_azimuth() -> None:
    sinograms: list[Float32Array] = []
    for first in (0.0, 90.0):
        camera, angles = camera_at(87.9), turn(first_deg=first)
        beam = parallel_beam(angles, COLUMNS, camera, OPTICS)
        found = resample(frames_of_ball(angles, camera), 0, angles, camera, OPTICS, beam, Z_MM)
        sinograms.append(np.roll(found, round(first / 2), axis=0))
    np.testing.assert_allclose(sinograms[0], sinograms[1], rtol=0, atol=1e-4)


def test_turning_the_object_shifts_the_sinogram() -> None:
    camera, angles = camera_at(87.9), turn()
    beam = parallel_beam(angles, COLUMNS, camera, OPTICS)
    frames = frames_of_ball(angles, camera)
    # The object turned by five frames is seen at angle i as it was at angle i + 5.
    straight, turned = (
        resample(np.roll(frames, -shift, axis=0), 0, angles, camera, OPTICS, beam, Z_MM) for shift in (0, 5)
    )
    np.testing.assert_allclose(turned, np.roll(straight, -5, axis=0), rtol=0, atol=1e-4)


def test_rows_that_are_not_needed_may_be_left_out() -> None:
    camera, angles = camera_at(87.9), turn(20)
    beam = parallel_beam(angles, COLUMNS, camera, OPTICS)
    frames = frames_of_ball(angles, camera)
    whole, window = (
        resample(frames[:, rows], rows.start, angles, camera, OPTICS, beam, Z_MM)
        for rows in (slice(0, 60), slice(12, 40))
    )
    np.testing.assert_allclose(window, whole, rtol=0, atol=1e-5)


def test_integrals_are_along_the_rays_plan_view() -> None:
    """A climbing ray is longer than its plan view, and collects more."""
    optics = Optics(12.4, 11.3, 1.472, 1.48, 40.0)
    camera = Camera(pixel_mm=0.155, axis_column=87.5, optical_row=75.0)
    beam = parallel_beam(turn(20), COLUMNS, camera, optics)
    found = resample(np.ones((20, 76, COLUMNS), np.float32), 0, turn(20), camera, optics, beam, np.array([9.0, 9.1]))
    slope = ray_tilt(beam.virtual_x_mm, optics)[:, None] * [9.0, 9.1]
    seen = np.abs(beam.virtual_x_mm) < 0.99 * optics.field_radius_mm
    assert slope.min() > 0.14
    np.testing.assert_allclose(found[:, seen], np.broadcast_to(1 / np.hypot(1, slope), found.shape)[:, seen], rtol=2e-3)


def test_a_wall_missing_from_the_rig_shows() -> None:
    """That the bounds above are tight enough to see the glass."""
    camera, angles = camera_at(87.9), turn()
    beam = parallel_beam(angles, COLUMNS, camera, OPTICS)
    bare = Optics(12.4, 12.4, 1.5, 1.48, 190.0)
    found = resample(frames_of_ball(angles, camera), 0, angles, camera, bare, beam, Z_MM)
    assert np.abs(found - sinogram_of_ball(beam)).max() > 5e-3


@settings(max_examples=25, deadline=None)
@given(
    st.integers(2, 6).flatmap(
        lambda half: arrays(np.float32, (2 * half, 5, 7), elements=st.floats(-100, 100, width=16))
    ),
    st.sampled_from([0.0, 1.0]),
    st.floats(0, 6),
)
def test_without_a_vial_even_frames_are_the_sinogram_itself(frames: Float32Array, cut: float, first: float) -> None:
    """Also where the axis falls between two columns (`cut` leaves the last one off)."""
    frames = frames[..., : 7 - int(cut)]
    camera = Camera(pixel_mm=0.5, axis_column=(frames.shape[2] - 1) / 2, optical_row=2.0)
    angles = first + np.arange(len(frames), dtype=np.float64) * (2 * np.pi / len(frames))
    beam = parallel_beam(angles, frames.shape[2], camera, None)
    z_mm = np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    found = resample(frames, 0, angles, camera, None, beam, z_mm)
    np.testing.assert_allclose(found, frames.transpose(0, 2, 1)[..., ::-1], rtol=0, atol=1e-4)


def test_a_recording_of_one_row_is_read_as_it_is() -> None:
    frames = np.random.default_rng(0).normal(size=(6, 1, 7)).astype(np.float32)
    camera = Camera(pixel_mm=0.5, axis_column=3.0, optical_row=0.0)
    angles = np.arange(6, dtype=np.float64) * (2 * np.pi / 6)
    beam = parallel_beam(angles, 7, camera, None)
    found = resample(frames, 0, angles, camera, None, beam, np.zeros(1))
    np.testing.assert_allclose(found, frames.transpose(0, 2, 1), rtol=0, atol=1e-6)


@settings(max_examples=15, deadline=None)
@given(st.floats(-5, 5), st.floats(-5, 5), st.integers(0, 2**32 - 1))
def test_resampling_is_linear(a: float, b: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    first, second = rng.normal(size=(2, 12, 30, COLUMNS)).astype(np.float32)
    camera, angles = camera_at(87.9), turn(12)
    beam = parallel_beam(angles, COLUMNS, camera, OPTICS)

    def read(frames: Float32Array) -> Float32Array:
        return resample(frames, 15, angles, camera, OPTICS, beam, Z_MM)

    mixed = read(np.float32(a) * first + np.float32(b) * second)
    np.testing.assert_allclose(mixed, a * read(first) + b * read(second), rtol=0, atol=1e-4)


@pytest.mark.parametrize(("columns", "axis"), [(176, 87.0), (176, 87.5), (175, 87.0), (175, 100.25)])
@pytest.mark.parametrize(("count", "last"), [(90, 178.0), (91, 180.0), (181, 180.0)])
def test_half_a_turn_of_parallel_rays_is_as_good_as_a_whole(count: int, last: float, columns: int, axis: float) -> None:
    angles, camera = np.radians(np.linspace(0, last, count)), camera_at(axis)
    beam = parallel_beam(angles, columns, camera, None)
    frames = frames_of_ball(angles, camera, None)[..., :columns]
    error = resample(frames, 0, angles, camera, None, beam, Z_MM) - sinogram_of_ball(beam, None)
    assert np.abs(error).max() < 5e-3


@pytest.mark.parametrize("angles", [gap(turn(), 100, 33), gap(turn(), 0, 33), turn()[:90]])
def test_a_gap_too_wide_is_refused(angles: FloatArray) -> None:
    camera = camera_at(87.9)
    beam = parallel_beam(angles, COLUMNS, camera, OPTICS)
    with pytest.raises(InputError, match=r"no frames for .* deg after .* deg; accepted: gaps of up to 30"):
        resample(np.zeros((len(angles), ROWS, COLUMNS), np.float32), 0, angles, camera, OPTICS, beam, Z_MM)
