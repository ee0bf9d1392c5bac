"""The figure of the axis: the edges of the vial over the turn, and what is left of each frame's axis."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from vialight.calibration.axis.estimator import AxisFit
from vialight.calibration.figures import BEFORE, FOUND
from vialight.calibration.opposite_sums import AXIS, OUT_X, OUT_Y
from vialight.core.drawing import new_figure, png, style

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def axis_round_png(found: AxisFit) -> bytes:
    """Draw the vial's edges, and what is left of each frame's axis, against the stage's angle."""
    angles = found.views.angles_rad
    with style():
        figure = new_figure(7.2, 4.4)
        above, below = figure.subplots(2, 1, sharex=True)
        _draw_edges(above, found)
        compared = found.fit.comparison
        weight = compared.normal[:, AXIS, AXIS].sum() / len(angles)
        left = -compared.gradient[:, :, AXIS].sum(axis=0) / weight
        below.plot(np.degrees(angles), left, ".", color=BEFORE, markersize=3)
        below.axhline(0, color="#5d6778", linewidth=0.6)
        below.set(xlabel="stage angle, deg", ylabel="axis left over, columns")
        below.grid(linewidth=0.3)
        return png(figure)


def _draw_edges(axis: Axes, found: AxisFit) -> None:
    camera, out = found.views.camera, found.fit.parameters[[OUT_X, OUT_Y]]
    turn = np.linspace(0, 2 * np.pi, 361)
    fitted = (out[0] * np.cos(turn) - out[1] * np.sin(turn)) / camera.pixel_mm
    if found.edges is not None and found.circle is not None:
        for columns, mean, mark, name in (
            (found.edges.left, found.circle.left, "<", "left edge"),
            (found.edges.right, found.circle.right, ">", "right edge"),
        ):
            if np.isfinite(columns).any():
                axis.plot(
                    np.degrees(np.mod(found.edge_angles_rad, 2 * np.pi)), columns - mean, mark, color=BEFORE,
                    markersize=2.5, linewidth=0, label=name,
                )  # fmt: skip
    axis.plot(np.degrees(turn), fitted, color=FOUND, linewidth=1.2, label="run-out found")
    axis.set_ylabel("vial's axis, columns")
    axis.grid(linewidth=0.3)
    axis.legend(frameon=False, ncols=3, fontsize="small")
