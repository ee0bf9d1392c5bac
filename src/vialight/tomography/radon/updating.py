"""Adding a few filtered projections to a volume that is there already, with its sums in the same sweep.

A volume of 480 x 480 x 300 voxels does not fit into any cache, so that reading and writing it is much of the work: all
projections that are new, and all sums over the volume, go into one pass over it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from vialight.core.arrays import Float32Array, FloatArray, IntArray
from vialight.core.compiling import FAST_MATH, aligned_zeros
from vialight.tomography.radon.taps import tap
from vialight.tomography.radon.workers import Workers

_ANGLES_A_PASS = 3
"""Projections added before a column is written back."""

_TILE_ROWS, _TILE_COLUMNS = 32, 16
"""Pixels of a tile: the stretches of projections and of sums that it touches stay in cache."""


class AxisSums(NamedTuple):
    """Sums over a volume along each of its axes."""

    xy: Float32Array
    """(y, x), along z."""
    xz: Float32Array
    """(x, z), along y."""
    yz: Float32Array
    """(y, z), along x."""


def add_projections(
    volume: Float32Array,
    filtered: Float32Array,
    psi_rad: FloatArray,
    first_s_mm: float,
    spacing_mm: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    inside: tuple[IntArray, IntArray],
    threshold: float,
    workers: Workers,
) -> tuple[AxisSums, AxisSums]:
    """Smear filtered projections back over their rays, add them to a volume and sum it up.

    Parameters
    ----------
    volume
        (y, x, z) float32, changed in place.
    filtered
        (psi, s, z) float32, as deep as the volume; any number of projections.
    psi_rad
        (psi,) their angles.
    first_s_mm, spacing_mm
        Position of the first sample and distance between samples.
    x_mm, y_mm
        Pixel centres.
    inside
        For each y, the first x that is changed and summed, and the one after the last.
    threshold
        Voxels above it are counted.
    workers
        Threads.

    Returns
    -------
    sums, counts : AxisSums
        Of the values inside, and of the voxels inside that lie above the threshold.
    """
    missing = -len(psi_rad) % _ANGLES_A_PASS
    if missing:
        filtered = np.concatenate([filtered, np.zeros((missing, *filtered.shape[1:]), np.float32)])
        psi_rad = np.concatenate([psi_rad, np.zeros(missing)])
    rows, columns, depth = volume.shape
    # Sums over x and z are each row's own; over y, each thread has its own.
    sums, counts = (
        AxisSums(
            aligned_zeros((rows, columns)),
            aligned_zeros((workers.count, columns, depth)),
            aligned_zeros((rows, depth)),
        )
        for _ in range(2)
    )
    cosine, sine = np.cos(psi_rad) / spacing_mm, np.sin(psi_rad) / spacing_mm

    def work(worker: int, task: int) -> None:
        strip = slice(task * _TILE_ROWS, (task + 1) * _TILE_ROWS)
        _add_and_sum(
            volume[strip], filtered, cosine, sine, first_s_mm / spacing_mm, x_mm, y_mm[strip],
            inside[0][strip], inside[1][strip], np.float32(threshold),
            sums.xy[strip], sums.xz[worker], sums.yz[strip], counts.xy[strip], counts.xz[worker], counts.yz[strip],
        )  # fmt: skip

    workers.run(-(-rows // _TILE_ROWS), work)
    return sums._replace(xz=sums.xz.sum(axis=0)), counts._replace(xz=counts.xz.sum(axis=0))


@njit(nogil=True, fastmath=FAST_MATH, cache=True)
def _add_and_sum(
    volume: Float32Array,
    filtered: Float32Array,
    cosine: FloatArray,
    sine: FloatArray,
    first: float,
    x_mm: FloatArray,
    y_mm: FloatArray,
    begin: IntArray,
    end: IntArray,
    threshold: np.float32,
    sums_xy: Float32Array,
    sums_xz: Float32Array,
    sums_yz: Float32Array,
    counts_xy: Float32Array,
    counts_xz: Float32Array,
    counts_yz: Float32Array,
) -> None:
    angles, samples, depth = filtered.shape
    stacks = filtered.reshape((angles * samples, depth))
    # Unsigned: a signed index would be looked at for counting from the end.
    one = np.uint64(1)
    at = np.empty((angles, _TILE_COLUMNS), np.uint64)
    v, w = np.empty((angles, _TILE_COLUMNS), np.float32), np.empty((angles, _TILE_COLUMNS), np.float32)
    for x_start in range(0, len(x_mm), _TILE_COLUMNS):
        for iy in range(len(y_mm)):
            low, high = max(x_start, begin[iy]), min(x_start + _TILE_COLUMNS, end[iy])
            for a in range(angles):
                offset = -y_mm[iy] * sine[a] - first
                for ix in range(low, high):
                    index, v[a, ix - low], w[a, ix - low] = tap(x_mm[ix] * cosine[a] + offset, samples)
                    at[a, ix - low] = a * samples + index
            for ix in range(low, high):
                column, i = volume[iy, ix], ix - low
                for a in range(0, angles, _ANGLES_A_PASS):
                    i0, i1, i2 = at[a, i], at[a + 1, i], at[a + 2, i]
                    v0, v1, v2 = v[a, i], v[a + 1, i], v[a + 2, i]
                    w0, w1, w2 = w[a, i], w[a + 1, i], w[a + 2, i]
                    for z in range(depth):
                        column[z] += (
                            v0 * stacks[i0, z]
                            + w0 * stacks[i0 + one, z]
                            + v1 * stacks[i1, z]
                            + w1 * stacks[i1 + one, z]
                            + v2 * stacks[i2, z]
                            + w2 * stacks[i2 + one, z]
                        )
                sums_xy[iy, ix] = _add_values(column, sums_xz[ix], sums_yz[iy])
                counts_xy[iy, ix] = _add_counts(column, threshold, counts_xz[ix], counts_yz[iy])


@njit(inline="always")
def _add_values(column: Float32Array, across: Float32Array, along: Float32Array) -> np.float32:
    # Loops of few arrays: more could overlap in more ways than the compiler looks at before it uses vectors.
    total = np.float32(0)
    for z in range(len(column)):
        total += column[z]
        across[z] += column[z]
    for z in range(len(column)):
        along[z] += column[z]
    return total


@njit(inline="always")
def _add_counts(column: Float32Array, threshold: np.float32, across: Float32Array, along: Float32Array) -> np.float32:
    count = np.float32(0)
    for z in range(len(column)):
        count += np.float32(1) if column[z] > threshold else np.float32(0)
    if count > 0:
        for z in range(len(column)):
            across[z] += np.float32(1) if column[z] > threshold else np.float32(0)
        for z in range(len(column)):
            along[z] += np.float32(1) if column[z] > threshold else np.float32(0)
    return count
