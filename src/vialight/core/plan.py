"""What a print is made from: light patterns, with all that they were computed from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import TURN_RAD, FloatArray, Grid
from vialight.core.config import Rig
from vialight.core.mesh import Mesh


@dataclass(frozen=True)
class Patterns:
    """Grey levels for the projector, to be asked for by stage angle.

    Parameters
    ----------
    levels
        (angle, row, column) uint8: the part of the projector's image that is not always black.
    angles_rad
        (angle,) stage angles, ascending and evenly spaced over a full turn; a pattern is due while the stage is nearer
        to its angle than to any other.  Counter-clockwise seen from above, whichever way the stage counts or turns.
    first_row, first_column
        Where in the projector's image the part begins.
    dose_rate_per_level
        Dose per radian of turn of light of one grey level, as it is in air in the plane of the axis; 1 is the dose that
        is meant inside the part after one turn.

    Notes
    -----
    A level stands for irradiance in air in the plane of the axis: a pixel of level g sends ``g * dose_rate_per_level``
    times the pixel's area, in air, into the vial.
    """

    levels: NDArray[np.uint8]
    angles_rad: FloatArray
    first_row: int
    first_column: int
    dose_rate_per_level: float

    @property
    def step_rad(self) -> float:
        """Angle between neighbouring patterns."""
        return TURN_RAD / len(self.angles_rad)

    def index_at(self, angle_rad: float) -> int:
        """Return the pattern that is due at a stage angle, of any turn.

        Examples
        --------
        >>> turn = Patterns(np.zeros((4, 1, 1), np.uint8), np.arange(4) * np.pi / 2, 0, 0, 1.0)
        >>> [turn.index_at(np.radians(angle)) for angle in (0, 44, 46, 359, 450)]
        [0, 0, 1, 0, 1]
        """
        return int(np.rint((angle_rad - self.angles_rad[0]) / self.step_rad)) % len(self.angles_rad)


@dataclass(frozen=True)
class Plan:
    """All that is needed to print a part, to simulate it, or to compute its patterns again.

    Parameters
    ----------
    patterns
        What the projector shows.
    reference
        The part as placed in the vial, object frame: what every later measurement is compared with.
    target
        (z, y, x) float32: share of each voxel that lies inside the part, 0 to 1.
    grid
        Where the target's voxels lie.
    rig
        The printer and the resin that the patterns are for.
    settings
        Method and parameters, as asked for; plain JSON values.
    metrics
        What the plan is expected to do; plain JSON values, with units in the names.
    inputs
        Role to ``{"file": name, "sha256": digest}``.
    """

    patterns: Patterns
    reference: Mesh
    target: NDArray[np.float32]
    grid: Grid
    rig: Rig
    settings: Mapping[str, Any] = field(default_factory=dict)
    metrics: Mapping[str, Any] = field(default_factory=dict)
    inputs: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
