"""Parallel-beam sinogram in, volume of scattering density out."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from vialight.core.arrays import Float32Array, FloatArray, ParallelBeam
from vialight.tomography.radon import (
    FilterName,
    backproject,
    backproject_tilted,
    filter_rays,
    fold,
    project_tilted,
    ramp_filter,
)

DEFAULT_FILTER: FilterName = "cosine"

_SMOOTHED = 2.0
"""Voxels of standard deviation: 0.93 passes of what rays that climb by 6 % leave unmeasured."""


def reconstruct_slices(
    sinogram: Float32Array,
    beam: ParallelBeam,
    x_mm: FloatArray,
    y_mm: FloatArray,
    *,
    filter_name: FilterName = DEFAULT_FILTER,
    radius_mm: float = np.inf,
    out: Float32Array | None = None,
) -> Float32Array:
    """Filter and backproject a sinogram, slice by slice.

    Opposite angles are folded first, which is exact for a linear filter and halves the work.

    Parameters
    ----------
    sinogram
        (psi, x_v, z) integrals along rays.
    beam
        Its rays.
    x_mm, y_mm
        Voxel centres.
    filter_name
        See `vialight.tomography.radon.ramp_filter`.
    radius_mm
        Farther from the axis nothing is wanted, see `vialight.tomography.radon.backproject`.
    out
        (z, y, x) contiguous float32 memory for the result; by default new memory.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, per mm.
    """
    half = len(beam.psi_rad) // 2
    filtered = _filter(fold(sinogram), beam, filter_name)
    first = float(beam.virtual_x_mm[0])
    made = backproject(
        filtered, beam.psi_rad[:half], first, beam.spacing_mm, x_mm, y_mm, radius_mm=radius_mm, slices=out
    )
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
        Heights of the sinogram; climb of the rays, see `vialight.tomography.radon.backproject_tilted`.
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


def reconstruct_climbing(
    sinogram: Float32Array,
    beam: ParallelBeam,
    mid_height_mm: FloatArray,
    tilt_per_mm: FloatArray,
    x_mm: FloatArray,
    y_mm: FloatArray,
    z_mm: FloatArray,
    radius_mm: float,
    *,
    filter_name: FilterName = DEFAULT_FILTER,
) -> Float32Array:
    """Reconstruct along rays that climb, and take what none of them measures from the reconstruction by level rays.

    The rays of one circular orbit climb alike from all sides: at a height z they leave a cone of frequencies about the
    axis unmeasured, as steep as they are (Tuy 1983), without which end faces lose their rims.  With A, F and B for
    projection, filter and backprojection, c along climbing and l along level rays, and x_l = G B_l F p,

        x = B_c F p + (B_l F A_l - B_c F A_c) x_l

    Where frequencies are measured the bracket is nothing and the first term is right; in the cone the first term and
    B_c F A_c are nothing, and what level rays make of the projections stays.  The cone is narrow, so that x_l may be
    smoothed in the plane, by G, beforehand: what noise the bracket would let through is gone.

    Parameters
    ----------
    sinogram
        (psi, x_v, z_mid).
    mid_height_mm
        The heights of slices, those wanted and more on either side: twice as many as rays climb in the field.
    tilt_per_mm, beam, x_mm, y_mm, z_mm, filter_name
        As for `reconstruct_tilted`.
    radius_mm
        Of the rays' field; beyond it nothing is taken to scatter, and nothing is wanted.

    Returns
    -------
    numpy.ndarray
        (z, y, x) float32, per mm.
    """
    outside = np.hypot(x_mm, y_mm[:, None]) > radius_mm
    by_level_rays = reconstruct_slices(sinogram, beam, x_mm, y_mm, filter_name=filter_name, radius_mm=radius_mm)
    smooth = gaussian_filter(np.where(outside, np.float32(0), by_level_rays), (0, _SMOOTHED, _SMOOTHED))
    columns = np.ascontiguousarray(smooth.transpose(1, 2, 0))
    psi, s, flat = beam.psi_rad, beam.virtual_x_mm, np.zeros_like(tilt_per_mm)
    unexplained = sinogram - project_tilted(columns, psi, s, tilt_per_mm, mid_height_mm, x_mm, y_mm)
    first = round((z_mm[0] - mid_height_mm[0]) / (mid_height_mm[1] - mid_height_mm[0]))
    wanted = np.ascontiguousarray(columns[..., first : first + len(z_mm)])
    level = project_tilted(wanted, psi, s, flat, z_mm, x_mm, y_mm)
    found = reconstruct_tilted(unexplained, beam, mid_height_mm, tilt_per_mm, x_mm, y_mm, z_mm, filter_name=filter_name)
    found += reconstruct_slices(level, beam, x_mm, y_mm, filter_name=filter_name, radius_mm=radius_mm)
    np.copyto(found, 0, where=outside)
    return found


def _filter(sinogram: Float32Array, beam: ParallelBeam, filter_name: FilterName) -> Float32Array:
    # Full turn: every ray is there twice, so half the angular step counts.
    scale = np.float32(np.pi / len(beam.psi_rad))
    matrix = ramp_filter(filter_name, sinogram.shape[1], beam.spacing_mm) * scale
    return filter_rays(matrix, np.ascontiguousarray(sinogram, dtype=np.float32))
