"""Prints how many kernels of the live volume have been compiled ahead, and how many only when frames came."""

from __future__ import annotations

import numpy as np

from vialight.core.config import Camera, Resin, Rig, Vial
from vialight.tomography.radon import filters, updating
from vialight.tomography.sinogram import resampling, streaming
from vialight.tomography.sliding.window import SlidingWindow, compile_kernels

KERNELS = (
    resampling.spline_coefficients,
    streaming._read_view,
    streaming.renew_rays,
    streaming.fold_changes,
    filters._filter_part,
    updating._add_and_sum,
)
RIG = Rig(
    vial=Vial(outer_radius_mm=12.4, wall_mm=1.1, wall_index=1.472),
    resin=Resin(index_imaging=1.48),
    camera=Camera(distance_mm=190.0, pixel_mm=0.31, axis_column=43.2, optical_row=9.3),
)


def signatures() -> int:
    """Return how many forms of kernels there are."""
    return sum(len(kernel.signatures) for kernel in KERNELS)


def main() -> None:
    """Count."""
    compile_kernels()
    known = signatures()
    for binning, dark in ((1, None), (2, np.ones((20, 88), np.uint16))):
        window = SlidingWindow(RIG, (20, 88), 60, dark=dark, threshold=1.0, binning=binning, voxel_mm=0.35)
        for frame in range(3):
            window.add(np.ones((20, 88), np.uint16), 0.1 * frame)
            window.renew()
    print(f"known: {known}, new: {signatures() - known}")


if __name__ == "__main__":
    main()
