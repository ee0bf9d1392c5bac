"""From recordings to volumes: traced cylinders, blocks, memory, settings, and a real tooth."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from soft_parts import frames_of_part
from vialight.core.arrays import Float32Array, FloatArray, Grid, Volume
from vialight.core.config import Camera, Resin, Rig, Stage, Vial
from vialight.core.errors import InputError, VialightWarning
from vialight.metrology.distance import sample_surface
from vialight.metrology.surface import isosurface
from vialight.store import FrameFile, open_frames, write_frames
from vialight.store.rig_files import load_rig
from vialight.tomography import reconstruct as pipeline
from vialight.tomography.reconstruct import Settings, grid_for, open_scan, reconstruct
from vialight.twin.sensor import Sensor

CENTRE, RADIUS, HALF_HEIGHT = (2.5, -1.5), 2.4, 2.5
ROWS, COLUMNS, ANGLES = 44, 176, 120
STRAY_LIGHT = np.where(np.abs(np.arange(COLUMNS) - 97) < 3, 300, 20) * np.ones((ROWS, 1))
"""An offset and a bright streak, which would be a ring in the volume."""

RIG = Rig(
    vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
    resin=Resin(index_imaging=1.48),
    camera=Camera(distance_mm=190.0, pixel_mm=0.155, axis_column=86.7, optical_row=22.3),
)


def cylinder(x: Any, y: Any, z: Any) -> Any:
    """Signed distance to a cylinder off the axis."""
    side, end = np.hypot(x - CENTRE[0], y - CENTRE[1]) - RADIUS, np.abs(z) - HALF_HEIGHT
    return np.minimum(np.maximum(side, end), 0) + np.hypot(np.maximum(side, 0), np.maximum(end, 0))


@pytest.fixture(scope="module")
def traced() -> tuple[Float32Array, FloatArray]:
    """Expected counts and angles of the cylinder."""
    angles = np.radians(10.0) + np.arange(ANGLES, dtype=np.float64) * (2 * np.pi / ANGLES)
    return frames_of_part(cylinder, Grid((124, 228, 228), 0.05), RIG, (ROWS, COLUMNS), angles), angles


@pytest.fixture(scope="module")
def recording(traced: tuple[Float32Array, FloatArray], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A noisy recording of the cylinder, over stray light."""
    path = tmp_path_factory.mktemp("recording") / "frames.h5"
    counts, angles = traced
    dark = STRAY_LIGHT.astype(np.uint16)
    write_frames(path, Sensor().photograph(counts + STRAY_LIGHT, np.random.default_rng(0)), angles, dark=dark)
    return path


def volume_of(path: Path, settings: Settings | None = None, rig: Rig = RIG, grid: Grid | None = None) -> Volume:
    settings = settings or Settings()
    with open_frames(path) as frames:
        return reconstruct(open_scan(frames, rig, settings), settings, grid=grid)


def interior(volume: Volume, depth_mm: float = 0.6) -> NDArray[np.float32]:
    grid = volume.grid
    z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij")
    inside: NDArray[np.float32] = volume.density[cylinder(x, y, z) < -depth_mm]
    return inside


def surface_error_mm(volume: Volume, threshold: float = 100.0) -> float:
    samples = sample_surface(isosurface(volume, threshold, smallest_piece_mm3=1.0), 20_000)
    return float(np.sqrt(np.average(cylinder(*samples.points_mm.T) ** 2, weights=samples.weights_mm2)))


@pytest.mark.parametrize("accurate", [False, True])
def test_a_cured_cylinder_off_axis_has_its_density_and_its_surface(recording: Path, accurate: bool) -> None:
    volume = volume_of(recording, Settings(accurate=accurate))
    inside = interior(volume)
    assert inside.mean() == pytest.approx(200, rel=0.005)
    assert np.median(inside) == pytest.approx(200, rel=0.005)
    assert surface_error_mm(volume) < 0.015
    grid = volume.grid
    cured = np.where(volume.density > 60, np.minimum(volume.density, 200), 0).astype(np.float64)
    centre = (cured.sum((0, 1)) @ grid.x_mm / cured.sum(), cured.sum((0, 2)) @ grid.y_mm / cured.sum())
    np.testing.assert_allclose(centre, CENTRE, rtol=0, atol=0.005)


def test_every_voxel_of_a_noiseless_interior_is_within_1_percent(
    traced: tuple[Float32Array, FloatArray], tmp_path: Path
) -> None:
    write_frames(tmp_path / "f.h5", np.rint(16 * traced[0]).astype(np.uint16), traced[1])
    np.testing.assert_allclose(interior(volume_of(tmp_path / "f.h5")), 3200, rtol=0.01)


def test_the_index_of_another_resin_shows(recording: Path) -> None:
    """That the bounds above are tight enough: 0.02 of the index shrink the part by 1.4 %."""
    wrong = RIG.model_copy(update={"resin": Resin(index_imaging=1.46)})
    assert surface_error_mm(volume_of(recording, rig=wrong)) > 0.02


def test_a_stage_that_counts_clockwise_gives_the_same_volume(
    traced: tuple[Float32Array, FloatArray], recording: Path, tmp_path: Path
) -> None:
    with open_frames(recording) as frames:
        write_frames(tmp_path / "f.h5", frames.read(slice(None)), -traced[1], dark=STRAY_LIGHT.astype(np.uint16))
    clockwise = RIG.model_copy(update={"stage": Stage(direction=-1)})
    grid = Grid((3, 80, 80), 0.2)
    volume = volume_of(tmp_path / "f.h5", rig=clockwise, grid=grid)
    np.testing.assert_allclose(volume.density, volume_of(recording, grid=grid).density, rtol=0, atol=1e-2)


def test_a_turn_is_chosen_from_many(traced: tuple[Float32Array, FloatArray], tmp_path: Path) -> None:
    counts, angles = traced
    path = tmp_path / "f.h5"
    series = [np.zeros_like(counts), counts, counts / np.float32(2), counts[:40] / np.float32(2)]
    cumulative = angles[0] + np.arange(3 * ANGLES + 40) * (2 * np.pi / ANGLES)
    write_frames(path, np.rint(np.concatenate(series)).astype(np.uint16), cumulative)
    grid = Grid((2, 60, 60), 0.2)
    means = [interior(volume_of(path, Settings(turn=turn), grid=grid)).mean() for turn in (None, 1, 2, 3)]
    np.testing.assert_allclose(means, [100, 0, 200, 100], rtol=0.01)
    with pytest.raises(InputError, match=r"--turn: is 4, .* accepted: 1 to 3"):
        volume_of(path, Settings(turn=4))


def test_binned_pixels_hold_the_sum_of_their_counts(recording: Path) -> None:
    volume = volume_of(recording, Settings(binning=2))
    assert volume.grid.voxel_mm == 0.155
    assert interior(volume).mean() == pytest.approx(4 * 200, rel=0.005)
    assert surface_error_mm(volume, 400.0) < 0.03


@pytest.mark.parametrize("accurate", [False, True])
def test_slices_in_blocks_equal_slices_at_once(
    recording: Path, monkeypatch: pytest.MonkeyPatch, accurate: bool
) -> None:
    settings = Settings(accurate=accurate, voxel_mm=0.16)
    monkeypatch.setattr(pipeline, "SLICES_A_BLOCK", 1000)
    at_once = volume_of(recording, settings).density
    monkeypatch.setattr(pipeline, "SLICES_A_BLOCK", 5)
    monkeypatch.setattr(pipeline, "FRAME_BYTES", 1)
    in_blocks = volume_of(recording, settings).density
    assert np.sqrt(np.mean((in_blocks - at_once) ** 2)) < 1e-4 * 200
    np.testing.assert_allclose(in_blocks, at_once, rtol=0, atol=2e-3 * 200)


@pytest.mark.parametrize("binning", [1, 2])
def test_frames_are_read_a_bounded_part_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, binning: int
) -> None:
    read, sizes = FrameFile.read, []

    def spy(self: FrameFile, frames: Any, rows: slice = slice(None)) -> Any:
        part = read(self, frames, rows)
        sizes.append(4 * part.size)  # in single precision
        return part

    rows, count = 400, 13
    path = tmp_path / "f.h5"
    write_frames(path, np.zeros((count, rows, COLUMNS), np.uint16), np.arange(count) * (2 * np.pi / count))
    limit = 4 * count * COLUMNS * 100
    monkeypatch.setattr(FrameFile, "read", spy)
    monkeypatch.setattr(pipeline, "SLICES_A_BLOCK", 8)
    monkeypatch.setattr(pipeline, "FRAME_BYTES", limit)
    volume_of(path, Settings(binning=binning, voxel_mm=0.3))
    assert max(sizes) <= limit
    assert 4 * count * COLUMNS * rows <= sum(sizes) < 2.5 * 4 * count * COLUMNS * rows
    assert len(sizes) <= 10


def test_progress_rises_to_the_end(recording: Path) -> None:
    calls: list[tuple[int, int]] = []
    with open_frames(recording) as frames:
        settings = Settings(voxel_mm=0.08)
        scan = open_scan(frames, RIG, settings)
        volume = reconstruct(scan, settings, progress=lambda done, total: calls.append((done, total)))
    done = [call[0] for call in calls]
    assert done == sorted(set(done))
    assert len(calls) > 1
    assert {call[1] for call in calls} == {done[-1]} == {volume.grid.shape[0]}


def test_the_grid_holds_the_field_and_every_height_that_all_columns_see(recording: Path) -> None:
    with open_frames(recording) as frames:
        scan = open_scan(frames, RIG, Settings())
        grid = grid_for(scan, scan.beam, None)
        coarse = grid_for(scan, scan.beam, 0.5)
    assert grid.voxel_mm == 0.155 / 2
    field = 12.4 / 1.48
    for name in ("x_mm", "y_mm"):
        ends = getattr(grid, name)[[0, -1]]
        np.testing.assert_allclose(ends, [-field, field], atol=grid.voxel_mm)
    # On the axis a row's height shrinks by the vial's lens effect: (176.8 + 0.75 + 7.64) / 190 = 0.977; a little less
    # at the sides.
    low, high = (22.3 - 43) * 0.155, 22.3 * 0.155
    np.testing.assert_allclose(grid.z_mm[[0, -1]], [0.977 * low, 0.977 * high], atol=0.1)
    assert coarse.shape[1] == coarse.shape[2] == 2 * int(field / 0.5)


def test_voxels_beyond_the_field_are_zero(recording: Path) -> None:
    grid = Grid((2, 190, 190), 0.1)
    density = volume_of(recording, grid=grid).density
    outside = np.hypot(grid.x_mm, grid.y_mm[:, None]) > 12.4 / 1.48
    assert (density[:, outside] == 0).all()
    assert np.isfinite(density).all()


def test_a_volume_larger_than_memory_is_refused_with_its_size(recording: Path) -> None:
    with pytest.raises(
        InputError, match=r"--voxel: 0.0005 mm makes \d+ x 33512 x 33512 voxels, [\d.]+ GB; accepted: .* GB"
    ):
        volume_of(recording, Settings(voxel_mm=0.0005))


@pytest.mark.parametrize("voxel", [0.0, -1.0, np.nan, np.inf])
def test_a_voxel_that_is_no_length_is_refused(voxel: float) -> None:
    with pytest.raises(InputError, match=r"--voxel: is .* a positive length in mm"):
        Settings(voxel_mm=voxel)


def test_binning_that_leaves_no_pixel_is_refused(recording: Path) -> None:
    with pytest.raises(InputError, match="--bin: is 0"):
        Settings(binning=0)
    with pytest.raises(InputError, match=rf"--bin: is 50 for {ROWS} x {COLUMNS} pixels"):
        volume_of(recording, Settings(binning=50))


def test_imaging_without_a_cameras_table_is_refused(recording: Path) -> None:
    with pytest.raises(InputError, match=r"no table \[camera\]"):
        volume_of(recording, rig=RIG.model_copy(update={"camera": None}))


def ordinary_fbp(integrals: FloatArray, angles: FloatArray, axis: float, pixels: FloatArray) -> FloatArray:
    """Parallel-beam filtered backprojection of half a turn, by Fourier transforms and np.interp."""
    columns = integrals.shape[1]
    padded = 4 * 2 ** int(np.ceil(np.log2(columns)))
    lag = np.minimum(np.arange(padded), padded - np.arange(padded))
    with np.errstate(divide="ignore"):
        kernel = np.where(lag % 2 == 1, -1 / (np.pi * lag) ** 2, 0.0)
    kernel[0] = 0.25
    spectrum = np.fft.rfft(integrals, padded, axis=1) * np.fft.rfft(kernel)
    filtered = np.fft.irfft(spectrum, padded, axis=1)[:, :columns]
    x, y = np.meshgrid(pixels, pixels)
    picture = np.zeros(x.shape)
    for angle, view in zip(angles, filtered, strict=True):
        picture += np.interp(x * np.cos(angle) - y * np.sin(angle) + axis, np.arange(columns), view)
    return picture * np.pi / len(angles)


def test_a_tooth_in_x_rays_equals_its_ordinary_reconstruction(shared_cases: Path) -> None:
    """Half a turn of real transmission data: its 181 frames include both 0 and 180 deg."""
    folder = shared_cases / "tooth"
    settings = Settings(voxel_mm=2.0, filter_name="ram-lak")
    with open_frames(folder / "frames.h5") as frames:
        # The axis is 24 columns off the middle.
        with pytest.warns(VialightWarning, match=r"24.0 columns off .* lies within 295.5 mm of the axis"):
            scan = open_scan(frames, load_rig(folder / "rig.toml"), settings)
        volume = reconstruct(scan, settings)
        raw, dark, white, angles = frames.read(slice(None)), frames.dark(), frames.white(), frames.angles_rad
    assert dark is not None
    assert white is not None
    row = 1
    integrals = -np.log(np.maximum((raw[:180, row] - dark[row]) / (white[row] - dark[row]), 1e-6))
    x_mm = volume.grid.x_mm
    expected = ordinary_fbp(integrals, angles[:180], 295.5, x_mm)
    # Row 1 is the lower of two, and z points up.
    found = volume.density[0].astype(np.float64)
    radius = np.hypot(x_mm, x_mm[:, None])
    seen = radius < 290
    tooth = expected > 0.5 * np.percentile(expected[seen], 95)
    mean = expected[tooth].mean()
    assert np.sqrt(np.mean((found - expected)[seen] ** 2)) < 0.05 * mean
    assert found[tooth].mean() == pytest.approx(mean, rel=0.005)
    assert abs(found[(radius > 250) & seen].mean()) < 0.02 * mean
    area, expected_area = (np.count_nonzero((picture > 0.5 * mean) & seen) for picture in (found, expected))
    assert area == pytest.approx(expected_area, rel=0.02)
    assert 0.02 < area / np.count_nonzero(seen) < 0.6
