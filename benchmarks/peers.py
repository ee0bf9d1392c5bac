"""Filtered backprojection by other packages, each as a practised user would call it.

All take (z, psi, s) float32 sinograms over half a turn, the two halves of the full turn already averaged, with rays
spaced by one voxel, and fill (z, y, x) squares of `count` voxels; the filter is vialight's default.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray
from vialight.tomography.radon import ramp_filter
from vialight.tomography.volume import DEFAULT_FILTER


def finufft_fbp(
    sinogram: Float32Array, psi_rad: FloatArray, count: int, voxel_mm: float, *, packed: bool, threads: int
) -> Float32Array:
    """Invert by the projection-slice theorem: FFT along rays, ramp, one non-uniform FFT (type 1) from polar samples.

    Single precision, relative tolerance 1e-3 (far below what rays and angles leave open), the smaller of finufft's
    oversampled grids, which is the faster one here, a plan that is set up once and does a batch at a time.

    Parameters
    ----------
    sinogram, psi_rad, count, voxel_mm
        See above.
    packed
        Two slices as real and imaginary part of one transform with both signs of frequency; otherwise one slice by the
        positive frequencies.
    threads
        Threads for both kinds of transform.
    """
    import finufft
    import scipy.fft

    transform: Any = scipy.fft.fft if packed else scipy.fft.rfft
    slices, views, samples = sinogram.shape
    length = 2 * samples  # no wrap-round within the field
    batch = 6
    frequency = np.fft.fftfreq(length) if packed else np.fft.rfftfreq(length)
    turn = 2 * np.pi * frequency
    along_x, along_y = np.cos(psi_rad)[:, None] * turn, -np.sin(psi_rad)[:, None] * turn

    kernel = ramp_filter(DEFAULT_FILTER, samples, voxel_mm)[0].astype(np.float64)
    ring = np.concatenate([kernel, [0.0], kernel[:0:-1]])
    ramp = (np.fft.fft if packed else np.fft.rfft)(ring).real
    if not packed:
        ramp[1:] *= 2  # for the negative frequencies, which the real part supplies
    # Both grids lie half a step from where the transforms count from.
    shift = turn * (samples - 1) / 2 + (along_x + along_y) / 2
    weight = (ramp * np.exp(1j * shift) * np.pi / (views * length)).astype(np.complex64)

    plan = finufft.Plan(1, (count, count), batch, 1e-3, 1, dtype="complex64", nthreads=threads, upsampfac=1.25)
    plan.setpts(*(np.ascontiguousarray(axis.ravel(), dtype=np.float32) for axis in (along_y, along_x)))

    out = np.empty((slices, count, count), np.float32)
    at_once = 2 * batch if packed else batch
    for start in range(0, slices, at_once):
        block = sinogram[start : start + at_once]
        real, imaginary = (block[:batch], block[batch:]) if packed else (block, block[:0])
        rays = np.zeros((batch, views, samples), np.complex64 if packed else np.float32)
        rays.real[: len(real)] = real
        if packed:
            rays.imag[: len(imaginary)] = imaginary
        polar = transform(rays, length, workers=threads)
        polar *= weight
        pictures = plan.execute(polar.reshape(batch, -1))
        out[start : start + len(real)] = pictures[: len(real)].real
        out[start + len(real) : start + len(block)] = pictures[: len(imaginary)].imag
    return out


def skimage_fbp(sinogram: Float32Array, psi_rad: FloatArray, count: int, voxel_mm: float) -> Float32Array:
    """Call `iradon` slice by slice; rays and voxels are counted from their middle ones, which the caller allows for."""
    import skimage.transform

    iradon: Any = skimage.transform.iradon
    degrees = np.degrees(psi_rad)
    return np.stack(
        [
            iradon(views.T, degrees, output_size=count, filter_name=DEFAULT_FILTER, circle=False) / voxel_mm
            for views in sinogram
        ]
    ).astype(np.float32)


def astra_fbp(sinogram: Float32Array, psi_rad: FloatArray, count: int, voxel_mm: float) -> Float32Array:
    """Run ASTRA's FBP for processors with its linear (Joseph) projector, slice by slice on one set of buffers."""
    import astra

    rays = astra.create_proj_geom("parallel", 1.0, sinogram.shape[2], psi_rad)
    square = astra.create_vol_geom(count, count)
    projector = astra.create_projector("linear", rays, square)
    views, picture = astra.data2d.create("-sino", rays), astra.data2d.create("-vol", square)
    settings = astra.astra_dict("FBP")
    settings |= {"ProjectorId": projector, "ProjectionDataId": views, "ReconstructionDataId": picture}
    settings["option"] = {"FilterType": DEFAULT_FILTER}
    algorithm = astra.algorithm.create(settings)
    out = np.empty((len(sinogram), count, count), np.float32)
    for z, slice_views in enumerate(sinogram):
        astra.data2d.store(views, slice_views)
        astra.algorithm.run(algorithm)
        # ASTRA's lengths are in voxels.
        out[z] = astra.data2d.get(picture) / voxel_mm
    astra.algorithm.delete(algorithm)
    astra.data2d.delete([views, picture])
    astra.projector.delete(projector)
    return out
