"""The dose of finished patterns in an ideal printer, by nothing that any optimiser computes with.

Light is parallel, a pixel is a square of even light as wide as a voxel, a pattern is held from half a step before its
angle to half a step after it, and nothing is absorbed.  A voxel's dose is the mean over points in it, each of which
reads the one pixel that it lies behind.
"""

from __future__ import annotations

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.compiling import FAST_MATH

SUBVOXELS = 3
"""Along x and along y, and angles for each pattern."""


def dose_in_ideal_printer(levels: NDArray[np.uint8], voxels: int) -> Float32Array:
    """Return the dose (z, y, x) of one turn, in levels times rad.

    Parameters
    ----------
    levels
        (angle, row, column) of a full turn: rows from the top, columns along s with the axis in the middle, pattern k
        due at k steps; a point is lit along ``s = x cos(angle) - y sin(angle)``.
    voxels
        Along x and along y, of which pixels have the width.
    """
    count, slices, _ = levels.shape
    turned = (np.arange(count * SUBVOXELS) - (SUBVOXELS - 1) / 2) * (2 * np.pi / (count * SUBVOXELS))
    points = (np.arange(voxels * SUBVOXELS) + 0.5) / SUBVOXELS - voxels / 2
    by_height = np.ascontiguousarray(levels[:, ::-1].transpose(0, 2, 1))
    dose = np.zeros((voxels, voxels, slices), np.float32)
    _expose(by_height, np.cos(turned), np.sin(turned), points, dose)
    dose *= 2 * np.pi / (len(turned) * SUBVOXELS**2)
    return np.ascontiguousarray(dose.transpose(2, 0, 1))


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _expose(
    levels: NDArray[np.uint8], cosine: FloatArray, sine: FloatArray, points: FloatArray, dose: Float32Array
) -> None:
    columns = levels.shape[1]
    for iy in prange(dose.shape[0]):
        for turn in range(len(cosine)):
            for ix in range(dose.shape[1]):
                lit = dose[iy, ix]
                for point in range(SUBVOXELS**2):
                    x, y = points[ix * SUBVOXELS + point % SUBVOXELS], points[iy * SUBVOXELS + point // SUBVOXELS]
                    column = int(np.floor(x * cosine[turn] - y * sine[turn] + columns / 2))
                    if 0 <= column < columns:
                        pixel = levels[turn // SUBVOXELS, column]
                        for z in range(len(lit)):
                            lit[z] += pixel[z]
