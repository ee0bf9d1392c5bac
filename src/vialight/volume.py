"""Parallel-beam sinogram in, volume of scattering density out."""

from __future__ import annotations

import numpy as np

from vialight.arrays import Float32Array, FloatArray, ParallelBeam
from vialight.radon import FilterName, backproject, backproject_tilted, filter_rays, ramp_filter

DEFAULT_FILTER: FilterName = "cosine"


def reconstruct_slices(
    sinogram: Float32Array,
    beam: ParallelBeam,
    x_mm: FloatArray,
    y_mm: FloatArray,
    *,
    filter_name: FilterName = DEFAULT_FILTER,
    out: Float32Array | None = None,
) -> Float32Array:
    """Filter and backproject a sinogram, slice by slice.

    Opposite angles are folded first, ``q(psi, s) = p(psi, s) + p(psi + pi, -s)``, which is exact for a linear filter
    and halves the work.

    Parameters
    ----------
    sinogram
        (psi, x_v, z) integrals along rays.
    beam
        Its rays.
    x_mm, y_mm
        Voxel centres.
    filter_name
        See `vialight.radon.ramp_filter`.
    out
        (z, y, x) contiguous float32 memory for the result; by default new memory.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, per mm.
    """
    half = len(beam.psi_rad) // 2
    folded = sinogram[:half] + sinogram[half:, ::-1]
    filtered = _filter(folded, beam, filter_name)
    first = float(beam.virtual_x_mm[0])
    made = backproject(filtered, beam.psi_rad[:half], first, beam.spacing_mm, x_mm, y_mm, slices=out)
    return made.transpose(2, 0, 1)


def reconstruct_tilted(
    sinogram: Float32Array,
    beam: ParallelBeam,
    mid_height_mm: FloatArray,
    tilt_per_mm: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    z_mm: FloatArray,
    *,
    filter_name: FilterName = DEFAULT_FILTER,
) -> Float32Array:
    """Filter and backproject along rays that climb, as they do above and below the optical axis.

    Parameters
    ----------
    sinogram
        (psi, x_v, z_mid), over a little more height than is wanted.
    mid_height_mm, tilt_per_mm
        Heights of the sinogram; climb of the rays, see `vialight.radon.backproject_tilted`.
    beam, x_mm, y_mm, filter_name
        As for `reconstruct_slices`.
    z_mm
        (z,) evenly spaced heights of the voxels.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, per mm.
    """
    filtered = _filter(sinogram, beam, filter_name)
    first = float(beam.virtual_x_mm[0])
    return backproject_tilted(
        filtered, beam.psi_rad, first, beam.spacing_mm, tilt_per_mm, mid_height_mm, x_mm, y_mm, z_mm
    ).transpose(2, 0, 1)


def _filter(sinogram: Float32Array, beam: ParallelBeam, filter_name: FilterName) -> Float32Array:
    # Full turn: every ray is there twice, so half the angular step counts.
    scale = np.float32(np.pi / len(beam.psi_rad))
    matrix = ramp_filter(filter_name, sinogram.shape[1], beam.spacing_mm) * scale
    return filter_rays(matrix, np.ascontiguousarray(sinogram, dtype=np.float32))
