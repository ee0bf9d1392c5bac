"""Figures of the calibrations of axis, vial and scale, as PNG."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vialight.arrays import FloatArray
from vialight.calibrate import AXIS, OUT_X, OUT_Y, AxisFit, Comparison, VialFit, bend_left, bend_rad
from vialight.config import Camera, Optics
from vialight.report.canvas import new_figure, png, style
from vialight.viewing import vial_edge_columns

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FOUND, _BEFORE = "#c0501a", "#18348f"


def frame_png(frame: Any, camera: Camera, optics: Optics | None, *, before: Camera | None = None) -> bytes:
    """Draw a frame (row, column) with axis and vial's edges as the rig has them, and as it had them before."""
    from matplotlib.colors import PowerNorm

    rows, columns = frame.shape
    with style():
        figure = new_figure(7.2, min(5.9 * rows / columns + 0.9, 7.2))
        axis = figure.add_subplot()
        # Darkened less where it is dark, so that the vial's faint edges show beside the part.
        levels = PowerNorm(0.4, vmin=0, vmax=max(1.0, float(np.percentile(frame, 99.5))))
        image = axis.imshow(frame, cmap="gray", norm=levels, interpolation="nearest")
        figure.colorbar(image, ax=axis, label="counts", fraction=0.03, pad=0.02)
        if before is not None:
            axis.axvline(before.axis_column, color="#7fb2ff", linestyle="--", linewidth=1, label="axis before")
        lean = np.tan(np.radians(camera.axis_tilt_deg or 0.0))
        ends = np.array([-0.5, rows - 0.5])
        aside = (camera.optical_row - ends) * lean
        axis.plot(camera.axis_column + aside, ends, color="#ff9d57", linestyle="--", linewidth=1, label="axis")
        if optics is not None:
            for index, edge in enumerate(vial_edge_columns(camera, optics)):
                label = None if index else "edges of the vial"
                axis.plot(edge + aside, ends, color="#3fd0c9", linewidth=1, label=label)
        axis.axhline(camera.optical_row, color="#8fdc6a", linestyle=":", linewidth=1, label="optical row")
        axis.set(xlabel="column", ylabel="row", xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
        figure.legend(loc="outside lower center", ncols=4, facecolor="#8a919c", frameon=True, fontsize="small")
        return png(figure)


def mirror_png(before: Comparison, after: Comparison, angles_deg: FloatArray) -> bytes:
    """Draw the sinogram's difference to its mirror image, before and after."""
    with style():
        figure = new_figure(7.2, 3.9)
        axes = figure.subplots(1, 2, sharey=True)
        limit = float(np.nanpercentile(np.abs(_middle(before)), 99)) or 1.0
        for axis, compared, name in zip(axes, (before, after), ("before", "after"), strict=True):
            image = axis.imshow(
                _middle(compared), cmap="RdBu_r", vmin=-limit, vmax=limit, aspect="auto", interpolation="nearest",
                extent=(0, compared.differences.shape[1], angles_deg[-1], angles_deg[0]),
            )  # fmt: skip
            axis.set_title(f"{name}: {compared.rms:.3g} counts RMS")
            axis.set_xlabel("columns beside the axis")
        axes[0].set_ylabel("stage angle, deg")
        figure.colorbar(image, ax=axes, label="counts, less the opposite view", fraction=0.04, pad=0.02)
        return png(figure)


def _middle(compared: Comparison) -> FloatArray:
    return np.asarray(compared.differences[:, :, compared.differences.shape[2] // 2], dtype=np.float64)


def bend_png(found: VialFit) -> bytes:
    """Draw by how much more rays bend than the rig had it, column by column, and as the values found have it."""
    columns = found.views.x_c_mm / found.views.camera.pixel_mm
    level = np.zeros(1)
    more = bend_rad(found.vector, columns, level) - bend_rad(found.vector_before, columns, level)
    with style():
        figure = new_figure(7.2, 4.6)
        above, below = figure.subplots(2, 1, sharex=True)
        value, _ = (np.degrees(part) for part in bend_left(found.compared_before))
        above.plot(np.arange(len(value)) + 0.5, value, ".", color=_BEFORE, markersize=3, label="each column")
        left, std = (np.degrees(part) for part in bend_left(found.compared))
        below.errorbar(columns, left, std, fmt=".", color=_BEFORE, markersize=3, linewidth=0.7)
        for axis in (above, below):
            axis.grid(linewidth=0.3)
            axis.axhline(0, color="#5d6778", linewidth=0.6)
        above.plot(columns, np.degrees(more[:, 0]), color=_FOUND, linewidth=1.2, label="values found")
        above.set_ylabel("bend less the rig's, deg")
        above.legend(frameon=False, ncols=2, fontsize="small")
        below.set(xlabel="columns beside the axis", ylabel="left over, deg")
        return png(figure)


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
        below.plot(np.degrees(angles), left, ".", color=_BEFORE, markersize=3)
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
                    np.degrees(np.mod(found.edge_angles_rad, 2 * np.pi)), columns - mean, mark, color=_BEFORE,
                    markersize=2.5, linewidth=0, label=name,
                )  # fmt: skip
    axis.plot(np.degrees(turn), fitted, color=_FOUND, linewidth=1.2, label="run-out found")
    axis.set_ylabel("vial's axis, columns")
    axis.grid(linewidth=0.3)
    axis.legend(frameon=False, ncols=3, fontsize="small")
