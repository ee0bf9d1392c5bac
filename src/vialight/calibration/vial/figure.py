"""The figure of the vial: by how much rays bend more than the rig had it."""

from __future__ import annotations

import numpy as np

from vialight.calibration.figures import BEFORE, FOUND
from vialight.calibration.vial.bending import bend_rad
from vialight.calibration.vial.estimator import VialFit, bend_left
from vialight.core.drawing import new_figure, png, style


def bend_png(found: VialFit) -> bytes:
    """Draw by how much more rays bend than the rig had it, column by column, and as the values found have it."""
    columns = found.views.x_c_mm / found.views.camera.pixel_mm
    level = np.zeros(1)
    more = bend_rad(found.vector, columns, level) - bend_rad(found.vector_before, columns, level)
    with style():
        figure = new_figure(7.2, 4.6)
        above, below = figure.subplots(2, 1, sharex=True)
        value, _ = (np.degrees(part) for part in bend_left(found.compared_before))
        above.plot(np.arange(len(value)) + 0.5, value, ".", color=BEFORE, markersize=3, label="each column")
        left, std = (np.degrees(part) for part in bend_left(found.compared))
        below.errorbar(columns, left, std, fmt=".", color=BEFORE, markersize=3, linewidth=0.7)
        for axis in (above, below):
            axis.grid(linewidth=0.3)
            axis.axhline(0, color="#5d6778", linewidth=0.6)
        above.plot(columns, np.degrees(more[:, 0]), color=FOUND, linewidth=1.2, label="values found")
        above.set_ylabel("bend less the rig's, deg")
        above.legend(frameon=False, ncols=2, fontsize="small")
        below.set(xlabel="columns beside the axis", ylabel="left over, deg")
        return png(figure)
