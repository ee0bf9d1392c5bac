"""What is added to an ideal frame: stray light, noise, and the steps of a converter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.twin.camera import Imager


@dataclass(frozen=True)
class StrayLight:
    """Light that does not come from the part, in counts of one of the rig's pixels.

    Parameters
    ----------
    base_counts
        Everywhere; assumed, as in the shared cases.
    edge_counts
        At the peak of the reflection at each edge of the vial; assumed.
    edge_width_mm
        Standard deviation of those peaks in the plane of the axis; assumed.
    """

    base_counts: float = 45.0
    edge_counts: float = 60.0
    edge_width_mm: float = 0.3

    def image(self, imager: Imager) -> FloatArray:
        """Return (row, column) expected counts of a frame without a part."""
        (rows, columns), camera, vial = imager.shape, imager.camera, imager.vial
        radius, distance = imager.optics.outer_radius_mm, imager.optics.distance_mm
        x_c = (np.arange(columns) - camera.axis_column) * camera.pixel_mm
        z_c = (camera.optical_row - np.arange(rows)[:, None]) * camera.pixel_mm
        aside, away = vial.shift_mm[0] + vial.tilt_rad[0] * z_c, distance + vial.shift_mm[1]
        # The rays that touch the vial leave the pupil at an angle to the one through its axis.
        peaks = [aside + radius, aside - radius]
        if np.isfinite(distance):
            towards, tangent = np.arctan2(aside, away), np.arcsin(radius / np.hypot(aside, away))
            peaks = [distance * np.tan(towards + side * tangent) for side in (1, -1)]
        off = np.minimum(*(np.abs(x_c - peak) for peak in peaks))
        line = self.base_counts + self.edge_counts * np.exp(-((off / self.edge_width_mm) ** 2) / 2)
        return np.asarray(line * imager.binning**2)


@dataclass(frozen=True)
class Sensor:
    """What turns light into numbers.

    Parameters
    ----------
    read_noise_counts
        Standard deviation of a pixel's read-out.
    electrons_per_count
        So that photon noise is that of as many electrons.
    bits
        Of the converter: where a pixel saturates.
    """

    read_noise_counts: float = 3.0
    electrons_per_count: float = 1.0
    bits: int = 12

    def photograph(
        self, expected: NDArray[np.floating], rng: np.random.Generator, *, binning: int = 1
    ) -> NDArray[np.uint16]:
        """Count photons and read them out.

        Parameters
        ----------
        expected
            Counts, of any shape, summed over binned pixels.
        rng
            Source of noise.
        binning
            Of the frame: read noise and the largest count are those of so many pixels squared.

        Returns
        -------
        numpy.ndarray
            uint16, of the shape of `expected`.
        """
        counted = rng.poisson(np.asarray(expected, dtype=np.float64) * self.electrons_per_count)
        read = rng.normal(0.0, self.read_noise_counts * binning, expected.shape)
        highest = min((2**self.bits - 1) * binning**2, 65535)
        return np.clip(np.rint(counted / self.electrons_per_count + read), 0, highest).astype(np.uint16)
