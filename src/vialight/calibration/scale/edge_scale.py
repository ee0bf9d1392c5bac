"""Millimetres a pixel: from the vial's edges and its diameter."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from vialight.calibration.edges import Edges, edge_x_c_mm
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError

STREAK_COLUMNS = 0.2
"""Standard uncertainty of where an edge lies in its streak of light."""


@dataclass(frozen=True)
class EdgeScale:
    """A pixel's size in the plane of the axis.

    Parameters
    ----------
    pixel_mm, std_mm
        And its standard uncertainty.
    left, right
        Columns of the edges, in the mean of all frames.
    """

    pixel_mm: float
    std_mm: float
    left: float
    right: float


def scale_from_edges(
    edges: Edges, diameter_mm: float, diameter_std_mm: float, camera: Camera, optics: Optics, where: object
) -> EdgeScale:
    """Return a pixel's size from the vial's edges: they are seen at ``x_c = R / sqrt(1 - (R/D)^2)``.

    Parameters
    ----------
    edges
        In every frame.
    diameter_mm, diameter_std_mm
        Of the vial, by calliper, and its standard uncertainty.
    camera, optics
        As the rig has them.
    where
        Named in errors.

    Raises
    ------
    InputError
        The edges do not show.

    Examples
    --------
    >>> camera = Camera(distance_mm=190.0, pixel_mm=0.15, axis_column=87.5, optical_row=60.0)
    >>> edges = Edges(np.full(3, 7.5), np.full(3, 167.5))
    >>> round(scale_from_edges(edges, 24.8, 0.02, camera, Optics(12.4, 11.3, 1.472, 1.48, 190.0), "").pixel_mm, 4)
    0.1553
    """
    left, right = (
        float(np.nanmedian(side)) if np.isfinite(side).mean() > 0.5 else np.nan for side in (edges.left, edges.right)
    )
    if not np.isfinite(right - left):
        hidden = " and ".join(name for name, at in (("left", left), ("right", right)) if not np.isfinite(at))
        raise InputError(
            where, f"the vial's {hidden} edge does not show near where the rig has it",
            accepted="frames with both edges in sight", remedy="correct axis_column and pixel_mm by a look at a frame",
        )  # fmt: skip
    edge = edge_x_c_mm(replace(optics, outer_radius_mm=diameter_mm / 2))
    pixel = 2 * edge / (right - left)
    std = pixel * np.hypot(diameter_std_mm / diameter_mm, np.sqrt(2) * STREAK_COLUMNS / (right - left))
    return EdgeScale(pixel, float(std), left, right)
