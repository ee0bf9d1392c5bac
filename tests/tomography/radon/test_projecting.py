"""Projection along climbing rays against a formula and against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from vialight.core.arrays import centred
from vialight.tomography.radon import project_tilted


def test_a_blob_is_integrated_as_its_formula_says() -> None:
    """A Gaussian of 4 voxels, whose integral along any line is a Gaussian of the distance; seen from all sides."""
    voxel, sigma, centre = 0.1, 0.4, np.array([0.7, -0.5, 6.2])
    x, z = centred(41, voxel), 6 + centred(41, voxel)
    psi, s = np.radians(np.arange(0.0, 360.0, 20.0)), centred(9, 0.25)
    tilt = 0.01 * (1 + 0.1 * np.abs(s))
    distance = (x - centre[0]) ** 2 + ((x - centre[1]) ** 2)[:, None]
    columns = np.exp(-(distance[..., None] + (z - centre[2]) ** 2) / (2 * sigma**2)).astype(np.float32)
    found = project_tilted(columns, psi, s, tilt, z, x, x)

    across = s[:, None] - (centre[0] * np.cos(psi) - centre[1] * np.sin(psi))[:, None, None]
    along = (centre[0] * np.sin(psi) + centre[1] * np.cos(psi))[:, None, None]
    slope = z * tilt[:, None]
    rise = z + along * slope - centre[2]
    stretch = np.sqrt(1 + slope**2)
    expected = np.sqrt(2 * np.pi) * sigma / stretch * np.exp(-(across**2 + (rise / stretch) ** 2) / (2 * sigma**2))
    # Linear interpolation across and in height adds at most 1 / 8 of a squared voxel, each, to the Gaussian's square.
    np.testing.assert_allclose(found, expected, rtol=0, atol=2 / 8 * (voxel / sigma) ** 2 * expected.max())


@pytest.mark.parametrize(("tilt", "depth"), [(0.0, 25), (0.0, 1), (0.02, 25), (-0.02, 25)])
def test_rays_pass_where_a_plain_reference_puts_them(tilt: float, depth: int) -> None:
    """Beyond both ends of the volume too, where it goes on as it ends."""
    voxel = 0.2
    columns = np.random.default_rng(0).normal(size=(12, 15, depth)).astype(np.float32)
    x, y, z = centred(15, voxel), centred(12, voxel), 4 + voxel * np.arange(depth, dtype=np.float64)
    psi, s = np.array([0.3, 1.2, 2.0, 4.4]), np.array([-0.7, 0.0, 0.31])
    found = project_tilted(columns, psi, s, np.full(3, tilt), z, x, y)
    for a, i in np.ndindex(4, 3):
        cosine, sine = np.cos(psi[a]), np.sin(psi[a])
        by_rows = abs(cosine) >= abs(sine)
        ray_y = y if by_rows else (x * cosine - s[i]) / sine
        ray_x = (s[i] + y * sine) / cosine if by_rows else x
        row, column = (ray_y - y[0]) / voxel, (ray_x - x[0]) / voxel
        within = (row >= 0) & (row <= len(y) - 1) & (column >= 0) & (column <= len(x) - 1)
        climb = (ray_x * sine + ray_y * cosine)[within, None] * tilt
        at = np.clip((z * (1 + climb) - z[0]) / voxel, 0, depth - 1)
        row, column = (np.broadcast_to(axis[within, None], at.shape) for axis in (row, column))
        read = map_coordinates(columns, [row, column, at], order=1, output=np.float64)
        expected = read.sum(axis=0) * voxel / max(abs(cosine), abs(sine))
        np.testing.assert_allclose(found[a, i], expected, rtol=0, atol=1e-5)
