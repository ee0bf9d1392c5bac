"""The camera against frames made by an optical model apart, against integrals known in closed form, and noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import igl
import numpy as np
import pytest

from soft_parts import softened
from vialight.core.arrays import Float32Array, FloatArray, Grid
from vialight.core.config import Camera, Resin, Rig, Vial
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.store import open_frames
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.twin.camera import frames_of, image_shape, imager_for
from vialight.twin.poses import Pose
from vialight.twin.rays import points_on_disk
from vialight.twin.sensor import Sensor, StrayLight


def bare(distance_mm: float = np.inf) -> Rig:
    """A vial that refracts nothing."""
    return Rig(
        vial=Vial(outer_radius_mm=12.4, wall_mm=0.0),
        resin=Resin(index_imaging=1.0),
        camera=Camera(distance_mm=distance_mm, pixel_mm=0.155, axis_column=87.5, optical_row=59.5),
    )


def ball(grid: Grid, centre: tuple[float, float, float], width: float) -> Float32Array:
    """A Gaussian density (y, x, z) about (x, y, z)."""
    x, y, z = centre
    density = (
        np.exp(-((grid.y_mm - y) ** 2) / (2 * width**2))[:, None, None]
        * np.exp(-((grid.x_mm - x) ** 2) / (2 * width**2))[:, None]
        * np.exp(-((grid.z_mm - z) ** 2) / (2 * width**2))
    )
    return np.asarray(density, dtype=np.float32)


@pytest.mark.parametrize("case", ["part", "cylinder"])
def test_frames_of_the_shared_cases_are_met_within_their_noise(shared_cases: Path, case: str) -> None:
    folder = shared_cases / case
    rig, mesh = load_rig(folder / "rig.toml"), load_mesh(folder / "truth.stl")
    with open_frames(folder / "frames.h5") as recording:
        rows, columns = recording.shape[1:]
        band = slice(50, 54)
        chosen = np.arange(3, 180, 11)
        frames = np.stack([recording.read(slice(i, i + 1), band)[0] for i in chosen]).astype(float)
        stray = recording.dark(band)
        angles = recording.angles_rad[chosen]
    assert stray is not None
    camera = rig.need_camera().model_copy(update={"optical_row": rig.need_camera().optical_row - band.start})
    rig = rig.model_copy(update={"camera": camera})
    grid = Grid((24, 256, 256), 0.05, 7.5 * 0.155 * 1.03)
    density = soft_part(mesh, grid)
    expected = frames_of(
        density, grid, imager_for(rig, (4, columns)), [Pose(float(angle)) for angle in angles], step_mm=0.05
    )
    edge = 12.4 / np.cos(np.arcsin(12.4 / 190)) / camera.pixel_mm
    seen = np.abs(np.arange(columns) - camera.axis_column) < 0.97 * edge
    # The stray light is the mean of 8 noisy frames itself, which alone makes 1.12 of 1 where there is no part.
    left = np.asarray(frames - expected - stray, dtype=float)[..., seen]
    chi = (left**2 / (expected + stray + 9)[..., seen]).mean()
    assert rows == 120
    assert 0.9 < chi < 1.15
    assert abs(left.sum()) < 2e-3 * expected.sum()


def soft_part(mesh: Mesh, grid: Grid) -> np.ndarray:
    """Density (y, x, z) of the shared cases."""

    def distance(points: FloatArray) -> FloatArray:
        kind = igl.SIGNED_DISTANCE_TYPE_PSEUDONORMAL
        return np.asarray(igl.signed_distance(points, mesh.vertices_mm, mesh.faces, sign_type=kind)[0])

    # Far from the surface only the sign matters: every fourth place decides where to look closely.
    y, x, z = np.meshgrid(grid.y_mm, grid.x_mm, grid.z_mm, indexing="ij")
    points = np.stack([x, y, z], axis=-1)
    coarse = distance(points[::4, ::4, ::4].reshape(-1, 3)).reshape(points[::4, ::4, ::4].shape[:3])
    rough = np.repeat(np.repeat(np.repeat(coarse, 4, 0), 4, 1), 4, 2)[: x.shape[0], : x.shape[1], : x.shape[2]]
    near = np.abs(rough) < 0.9
    rough[near] = distance(points[near])
    return np.asarray(softened(rough), dtype=np.float32)


def test_a_gaussian_ball_is_seen_as_its_integral_where_it_is() -> None:
    grid, width = Grid((80, 120, 120), 0.1), 0.5
    density, centre = ball(grid, (2.0, 3.0, -1.0), width), (2.0, -1.0)
    imager = imager_for(bare())
    frames = frames_of(density, grid, imager, [Pose(0.0), Pose(np.pi / 2)])
    x_c = (np.arange(176) - 87.5) * 0.155
    z_c = (59.5 - np.arange(120))[:, None] * 0.155
    peak = np.sqrt(2 * np.pi) * width
    for frame, x in zip(frames, (centre[0], -3.0), strict=True):  # a quarter turn brings +y to -x
        expected = peak * np.exp(-((x_c - x) ** 2 + (z_c + 1.0) ** 2) / (2 * width**2))
        np.testing.assert_allclose(frame, expected, atol=1.2e-2 * peak)


def test_a_leaning_axis_moves_the_image_with_height() -> None:
    grid = Grid((120, 60, 60), 0.1)
    density = ball(grid, (0.0, 0.0, 4.0), 0.4)
    frames = frames_of(
        density, grid, imager_for(bare()), [Pose(0.0), Pose(1.0, tilt_rad=(0.05, 0.0)), Pose(1.0, shift_mm=(0.2, 0.0))]
    )
    x_c = (np.arange(176) - 87.5) * 0.155
    centres = (frames.sum(axis=1) * x_c).sum(axis=1) / frames.sum(axis=(1, 2))
    np.testing.assert_allclose(centres, [0.0, 0.2, 0.2], atol=1e-3)


def test_binned_pixels_count_what_their_parts_counted() -> None:
    grid = Grid((60, 80, 80), 0.1)
    density, poses = ball(grid, (1.0, 0.0, 0.5), 0.7), [Pose(0.4)]
    fine = frames_of(density, grid, imager_for(bare(190.0)), poses)[0]
    for binning in (2, 4, 8):
        coarse = frames_of(density, grid, imager_for(bare(190.0), binning=binning, rays_a_side=4), poses)[0]
        parts = fine.reshape(120 // binning, binning, 176 // binning, binning).sum(axis=(1, 3))
        np.testing.assert_allclose(coarse, parts, atol=0.02 * parts.max())


def test_what_lies_above_shadows_and_what_lies_in_front_hides() -> None:
    """A slab of density p dims light as exp(-e p depth): from above, and again on its way to the camera."""
    grid, extinction = Grid((50, 60, 60), 0.1), 2e-3
    density = np.full((60, 60, 50), 200, np.float32)
    imager = imager_for(bare())
    frame = frames_of(density, grid, imager, [Pose(0.0)], extinction_mm2=extinction, step_mm=0.05)[0]
    k = extinction * 200
    row, depth_mm = 50, 2.5 - (59.5 - 50) * 0.155
    towards_camera = (1 - np.exp(-k * 6.0)) / k
    assert frame[row, 88] == pytest.approx(200 * np.exp(-k * depth_mm) * towards_camera, rel=0.02)
    assert frame[row - 4, 88] / frame[row, 88] == pytest.approx(np.exp(k * 4 * 0.155), rel=0.01)


def test_rays_bend_towards_the_higher_index() -> None:
    """A Gaussian bump of index turns a ray by the slope of its line integral, over the index."""
    grid, width, bump = Grid((60, 100, 100), 0.1), 0.8, np.float32(0.01)
    rise = bump * ball(grid, (0.0, -2.0, 0.0), width)  # over an index of 1
    # Behind it a screen whose density tells where it is seen.
    density = np.zeros_like(rise)
    density[np.abs(grid.y_mm - 3.0) < 0.12] = (200 + 40 * grid.x_mm)[:, None]
    imager = imager_for(bare())
    straight = frames_of(density, grid, imager, [Pose(0.0)], step_mm=0.02)[0]
    bent = frames_of(density, grid, imager, [Pose(0.0)], index_rise=rise, step_mm=0.02)[0]
    x = (np.arange(176) - 87.5) * 0.155
    seen = np.abs(x) < 2
    level = straight[60, seen] / (200 + 40 * x[seen])
    moved = (bent[60, seen] - straight[60, seen]) / level / 40
    turned = -bump * np.sqrt(2 * np.pi) * x[seen] / width * np.exp(-((x[seen] / width) ** 2) / 2)
    np.testing.assert_allclose(moved, 5.0 * turned, atol=6e-3)
    assert np.abs(moved).max() > 0.04
    with pytest.raises(InputError, match="extinction"):
        frames_of(density, grid, imager, [Pose(0.0)], index_rise=rise, extinction_mm2=1e-3)


def test_an_open_aperture_blurs_what_is_out_of_focus() -> None:
    grid = Grid((30, 120, 120), 0.1)
    near, far = ball(grid, (0.0, -5.0, 0.0), 0.2), ball(grid, (0.0, 0.0, 0.0), 0.2)
    disk = points_on_disk(40, 8.0)
    imager = imager_for(bare(190.0), pupil_mm=disk)
    thin = imager_for(bare(190.0))
    x_c = (np.arange(176) - 87.5) * 0.155

    def width(frame: FloatArray) -> float:
        line = frame.sum(axis=0) / frame.sum()
        return float(np.sqrt((line * (x_c - (line * x_c).sum()) ** 2).sum()))

    spread = {
        name: [width(frames_of(density, grid, seen, [Pose(0.0)])[0]) for seen in (thin, imager)]
        for name, density in (("near", near), ("far", far))
    }
    assert spread["far"][1] == pytest.approx(spread["far"][0], rel=0.02)
    # A disk of the pupil's radius over D, at 5 mm from the focus: a quarter of its radius squared more variance.
    extra = spread["near"][1] ** 2 - spread["near"][0] ** 2
    assert extra == pytest.approx((8.0 * 5.0 / 190.0) ** 2 / 4, rel=0.1)


def test_noise_is_that_of_photons_and_of_reading_out() -> None:
    rng, sensor = np.random.default_rng(0), Sensor(read_noise_counts=3.0)
    counts = sensor.photograph(np.full(200_000, 400.0), rng).astype(float)
    assert counts.mean() == pytest.approx(400, abs=0.2)
    assert counts.var() == pytest.approx(409 + 1 / 12, rel=0.02)
    quiet = replace(sensor, electrons_per_count=4.0).photograph(np.full(200_000, 400.0), rng).astype(float)
    assert quiet.var() == pytest.approx(109 + 1 / 12, rel=0.02)
    binned = sensor.photograph(np.full(200_000, 1600.0), rng, binning=2).astype(float)
    assert binned.var() == pytest.approx(1636, rel=0.02)


def test_a_pixel_saturates_where_its_converter_does() -> None:
    rng, light = np.random.default_rng(0), np.full(100, 1e6)
    assert set(Sensor().photograph(light, rng)) == {4095}
    assert set(Sensor().photograph(light, rng, binning=2)) == {4 * 4095}


def test_stray_light_peaks_at_the_vials_edges() -> None:
    imager = imager_for(bare(190.0))
    image = StrayLight().image(imager)
    camera = imager.camera
    offset = np.abs(np.argmax(image[0, : image.shape[1] // 2]) - camera.axis_column) * camera.pixel_mm
    assert offset == pytest.approx(12.4 / np.sqrt(1 - (12.4 / 190) ** 2), abs=camera.pixel_mm)
    assert image.min() >= StrayLight().base_counts


def test_nothing_scattering_is_seen_as_nothing() -> None:
    grid = Grid((4, 4, 4), 1.0)
    assert not frames_of(np.zeros((4, 4, 4), np.float32), grid, imager_for(bare()), [Pose(0.0)]).any()


def test_what_a_camera_cannot_do_is_told() -> None:
    with pytest.raises(InputError, match="binning"):
        imager_for(bare(), binning=3)
    with pytest.raises(InputError, match="parallel"):
        imager_for(bare().model_copy(update={"geometry": "parallel"}))
    assert image_shape(bare().need_camera()) == (120, 176)
