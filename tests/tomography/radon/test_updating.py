"""Projections added to a volume: against backprojection at once, and sums against NumPy's."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.core.arrays import IntArray, centred
from vialight.tomography.radon import backproject
from vialight.tomography.radon.updating import add_projections
from vialight.tomography.radon.workers import Workers

SAMPLES, SPACING_MM = 41, 0.3
X_MM, Y_MM = centred(50, 0.27), centred(37, 0.27)


def inside(radius_mm: float) -> tuple[IntArray, IntArray]:
    within = np.hypot(X_MM, Y_MM[:, None]) <= radius_mm
    begin = np.where(within.any(axis=1), within.argmax(axis=1), 0).astype(np.int64)
    return begin, begin + within.sum(axis=1)


@pytest.mark.parametrize("depth", [1, 16, 45])
@pytest.mark.parametrize("angles", [1, 3, 4, 11])
def test_what_is_added_is_the_backprojection_and_sums_are_those_of_the_volume(angles: int, depth: int) -> None:
    rng = np.random.default_rng(angles)
    filtered = rng.normal(size=(angles, SAMPLES, depth)).astype(np.float32)
    psi = rng.uniform(0, 2 * np.pi, angles)
    first = -(SAMPLES - 1) / 2 * SPACING_MM
    volume = rng.normal(size=(len(Y_MM), len(X_MM), depth)).astype(np.float32)
    disk = np.hypot(X_MM, Y_MM[:, None]) <= 4.5
    volume[~disk] = 0
    added = backproject(filtered, psi, first, SPACING_MM, X_MM, Y_MM)
    expected = volume + np.where(disk[..., None], added, 0)
    sums, counts = add_projections(volume, filtered, psi, first, SPACING_MM, X_MM, Y_MM, inside(4.5), 0.5, Workers(2))
    np.testing.assert_allclose(volume, expected, rtol=0, atol=1e-5)
    above = volume > 0.5
    for axis, found, counted in zip((2, 0, 1), sums, counts, strict=True):
        np.testing.assert_allclose(found, volume.sum(axis=axis, dtype=np.float64), rtol=0, atol=1e-4)
        np.testing.assert_array_equal(counted, above.sum(axis=axis))
