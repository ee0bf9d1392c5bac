"""Filtered backprojection against disks, whose projections and density are known exactly."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import erf

from vialight.core.arrays import Float32Array, FloatArray, ParallelBeam, centred
from vialight.tomography.radon import FilterName
from vialight.tomography.volume import reconstruct_slices, reconstruct_tilted

SPACING = 0.1
RADIUS = 2.0
DENSITY = 200.0


def beam_of(angles: int, samples: int, first_rad: float = 0.0) -> ParallelBeam:
    psi = first_rad + np.arange(angles, dtype=np.float64) * (2 * np.pi / angles)
    return ParallelBeam(psi, centred(samples, SPACING))


def projections_of_disk(beam: ParallelBeam, centre_mm: tuple[float, float], radius_mm: float = RADIUS) -> FloatArray:
    """Mean chord over each sample's width: (psi, s), density 1."""

    def area_left_of(s: FloatArray) -> FloatArray:
        t = np.clip(s / radius_mm, -1, 1)
        return np.asarray(radius_mm**2 * (t * np.sqrt(1 - t**2) + np.arcsin(t)))

    middle = centre_mm[0] * np.cos(beam.psi_rad) - centre_mm[1] * np.sin(beam.psi_rad)
    s = beam.virtual_x_mm - middle[:, None]
    return (area_left_of(s + SPACING / 2) - area_left_of(s - SPACING / 2)) / SPACING


def slices_of_disk(
    beam: ParallelBeam, centre_mm: tuple[float, float], pixels: FloatArray, filter_name: FilterName = "cosine"
) -> Float32Array:
    sinogram = (DENSITY * projections_of_disk(beam, centre_mm))[..., None].astype(np.float32)
    picture: Float32Array = reconstruct_slices(sinogram, beam, pixels, pixels, filter_name=filter_name)[0]
    return picture


def centroid(picture: FloatArray, pixels: FloatArray) -> tuple[float, float]:
    x, y = np.meshgrid(pixels, pixels)
    return float((picture * x).sum() / picture.sum()), float((picture * y).sum() / picture.sum())


@pytest.mark.parametrize("filter_name", ["ram-lak", "shepp-logan", "cosine", "hann"])
@pytest.mark.parametrize(("samples", "pixels"), [(100, 80), (101, 81), (100, 81), (101, 80)])
@pytest.mark.parametrize("centre", [(0.0, 0.0), (1.37, -0.91)])
def test_disk_has_its_density_and_place_for_even_and_odd_sizes(
    centre: tuple[float, float], samples: int, pixels: int, filter_name: FilterName
) -> None:
    x_mm = centred(pixels, SPACING)
    picture = slices_of_disk(beam_of(360, samples), centre, x_mm, filter_name).astype(np.float64)
    distance = np.hypot(x_mm - centre[0], x_mm[:, None] - centre[1])
    inside, outside = picture[distance < 0.8 * RADIUS], picture[(distance > 1.2 * RADIUS) & (distance < 2 * RADIUS)]
    assert inside.mean() == pytest.approx(DENSITY, rel=1e-3)
    np.testing.assert_allclose(inside, DENSITY, rtol=0.01)
    assert abs(outside.mean()) < 1e-3 * DENSITY
    disk = np.where(distance < 1.3 * RADIUS, picture, 0)
    np.testing.assert_allclose(centroid(disk, x_mm), centre, rtol=0, atol=0.01 * SPACING)


def test_the_edge_of_a_disk_is_at_half_its_density() -> None:
    x_mm = centred(121, SPACING / 2)
    row = slices_of_disk(beam_of(360, 100), (0.0, 0.0), x_mm)[60]
    edges = [float(np.interp(-DENSITY / 2, -row[60:], x_mm[60:])), float(np.interp(DENSITY / 2, row[:61], x_mm[:61]))]
    np.testing.assert_allclose(edges, [RADIUS, -RADIUS], rtol=0, atol=0.05 * SPACING)


def test_voxels_finer_or_coarser_than_samples_keep_the_density() -> None:
    for voxel in (0.03, 0.25):
        x_mm = centred(9, voxel)
        np.testing.assert_allclose(slices_of_disk(beam_of(180, 100), (0.0, 0.0), x_mm), DENSITY, rtol=2e-3)


@settings(max_examples=20, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(0, 2.5), st.floats(0, 2 * np.pi))
def test_where_the_turn_begins_does_not_matter(azimuth: float, off_axis: float, first: float) -> None:
    centre = (off_axis * np.cos(azimuth), off_axis * np.sin(azimuth))
    x_mm = centred(40, 0.25)
    from_zero, from_first = (slices_of_disk(beam_of(240, 100, start), centre, x_mm) for start in (0.0, first))
    field = np.hypot(x_mm, x_mm[:, None]) < 4.5
    np.testing.assert_allclose(from_first[field], from_zero[field], rtol=0, atol=0.03 * DENSITY)
    assert np.sqrt(np.mean((from_first - from_zero)[field] ** 2)) < 0.005 * DENSITY


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_slices_do_not_know_of_each_other(seed: int) -> None:
    sinogram = np.random.default_rng(seed).normal(size=(10, 16, 5)).astype(np.float32)
    beam, x_mm = beam_of(10, 16), centred(12, SPACING)
    together = reconstruct_slices(sinogram, beam, x_mm, x_mm)
    for z in range(5):
        alone = reconstruct_slices(sinogram[..., z : z + 1], beam, x_mm, x_mm)[0]
        np.testing.assert_allclose(together[z], alone, rtol=0, atol=1e-5)


def test_folding_opposite_views_changes_nothing() -> None:
    """`reconstruct_tilted` without climb sums the whole turn, `reconstruct_slices` folds it."""
    sinogram = np.random.default_rng(0).normal(size=(14, 21, 4)).astype(np.float32)
    beam, x_mm, z_mm = beam_of(14, 21), centred(24, SPACING), 1 + centred(4, 0.1)
    unfolded = reconstruct_tilted(sinogram, beam, z_mm, np.zeros(21), x_mm, x_mm, z_mm)
    np.testing.assert_allclose(unfolded, reconstruct_slices(sinogram, beam, x_mm, x_mm), rtol=0, atol=1e-4)


def test_a_thin_plate_off_axis_keeps_its_thickness_only_if_the_climb_of_rays_is_followed() -> None:
    """A disk 3 mm off axis, of Gaussian thickness about z = 8 mm, seen along rays of slope 8 / (190 * 1.48).

    The ray of mid-height m is at height ``m (1 + t tilt)``, so its integral over the chord is a difference of error
    functions.  What is left after following the climb (about 2 %) are the steepest 1.6 deg of the plate's spectrum,
    which no ray of a single circular orbit sees.
    """
    beam, tilt, sigma, plate, radius, centre = beam_of(180, 100), 1 / (190 * 1.48), 0.1, 8.0, 1.0, (2.0, -2.2)
    heights = plate + centred(81, 0.025)
    psi = beam.psi_rad[:, None, None]
    s = beam.virtual_x_mm[:, None] - (centre[0] * np.cos(psi) - centre[1] * np.sin(psi))
    along = centre[0] * np.sin(psi) + centre[1] * np.cos(psi)
    half_chord, slope = np.sqrt(np.maximum(radius**2 - s**2, 0)), heights * tilt
    near, far = (erf((heights + (along + end * half_chord) * slope - plate) / (np.sqrt(2) * sigma)) for end in (-1, 1))
    sinogram = ((far - near) * np.sqrt(np.pi / 2) * sigma / slope).astype(np.float32)
    x_mm, y_mm, z_mm = centre[0] + centred(9, 0.1), centre[1] + centred(9, 0.1), plate + centred(25, 0.025)
    inside = np.hypot(x_mm - centre[0], (y_mm - centre[1])[:, None]) < 0.6 * radius
    true = np.exp(-((z_mm - plate) ** 2) / (2 * sigma**2))[:, None]
    followed = reconstruct_tilted(sinogram, beam, heights, np.full(100, tilt), x_mm, y_mm, z_mm)[:, inside]
    flat = reconstruct_slices(sinogram, beam, x_mm, y_mm)[np.abs(heights - z_mm[:, None]).argmin(axis=1)][:, inside]
    np.testing.assert_allclose(followed, np.broadcast_to(true, followed.shape), rtol=0, atol=0.035)
    assert np.abs(flat - true).max() > 5 * np.abs(followed - true).max()
