"""The part of a vial that the projector can write into."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.config import Projector, Rig
from vialight.core.errors import InputError
from vialight.optics.refraction import camera_to_virtual
from vialight.optics.viewing import heights_seen

FIELD_MARGIN = 0.998
"""Share of the field's radius that is used.  At its edge light only grazes the glass and none of it enters, and away
from the mid-plane the field is 0.1 % smaller."""


@dataclass(frozen=True)
class Room:
    """A cylinder about the rotation axis, object frame.

    Parameters
    ----------
    radius_mm
        Largest distance from the axis.
    bottom_mm, top_mm
        Lowest and highest z.

    Examples
    --------
    >>> Room(8.0, -10.0, 12.0).height_mm
    22.0
    """

    radius_mm: float
    bottom_mm: float
    top_mm: float

    @property
    def height_mm(self) -> float:
        """From bottom to top."""
        return self.top_mm - self.bottom_mm


def printable_room(rig: Rig) -> Room:
    """Find the cylinder that the projector's light reaches from every side.

    Its radius is limited by refraction (``|x_v| < R / n``), by the glass, and by the projector's columns on that side
    of the axis where there are fewer; its height by the projector's rows, where every column sees them.

    Raises
    ------
    InputError
        The rig has no projector, no vial, no writing index, or its projector does not look at the axis.

    Examples
    --------
    >>> rig = Rig.model_validate({
    ...     "geometry": "parallel",
    ...     "projector": {"distance_mm": 100.0, "pixel_mm": 0.1, "columns": 101, "rows": 51, "axis_column": 40.0,
    ...                   "azimuth_deg": -90.0},
    ... })
    >>> printable_room(rig)
    Room(radius_mm=4.0, bottom_mm=-2.5, top_mm=2.5)
    """
    projector = rig.need_projector()
    optics = rig.writing_optics()
    columns_beside_axis = min(projector.axis_column, projector.columns - 1 - projector.axis_column)
    if columns_beside_axis <= 0:
        raise InputError(
            f"{rig.source} [projector]", f"axis_column {projector.axis_column:g} leaves no columns on one side",
            accepted=f"between 0 and columns - 1 = {projector.columns - 1}", remedy="measure where the axis is seen",
        )  # fmt: skip
    radius = columns_beside_axis * projector.pixel_mm
    if optics is not None:
        # NaN where the outermost column looks past the vial: then the field is the limit.
        reached = float(camera_to_virtual(radius, 0.0, optics).virtual_x_mm)
        radius = float(np.fmin(FIELD_MARGIN * optics.field_radius_mm, reached))
    bottom, top = heights_seen(projector.rows, projector.as_camera(), optics)
    if not bottom < top:
        raise _no_height(rig, projector)
    return Room(radius, bottom, top)


def _no_height(rig: Rig, projector: Projector) -> InputError:
    return InputError(
        f"{rig.source} [projector]",
        f"its {projector.rows} rows about optical_row {projector.as_camera().optical_row:g} leave no height "
        "that every column sees",
        accepted="rows that look at the vial", remedy="correct rows, optical_row or pixel_mm",
    )  # fmt: skip
