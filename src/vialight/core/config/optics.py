"""What a device's rays pass through."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Optics:
    """A pupil looking at a vial: all that the course of a ray depends on.

    Parameters
    ----------
    outer_radius_mm, inner_radius_mm
        Radii of the vial's glass; equal where there is no glass.
    wall_index, resin_index
        Refractive indices of glass and resin at the device's wavelength; air is 1.
    distance_mm
        From the pupil to the rotation axis; ``inf`` for a telecentric device.
    """

    outer_radius_mm: float
    inner_radius_mm: float
    wall_index: float
    resin_index: float
    distance_mm: float

    @property
    def field_radius_mm(self) -> float:
        """Largest ``|x_v|`` that any ray reaches, ``min(R / n_r, R_i)``."""
        return min(self.outer_radius_mm / self.resin_index, self.inner_radius_mm)
