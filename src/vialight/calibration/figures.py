"""Figures of the calibrations of axis, vial and scale, as PNG."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from vialight.calibration.opposite_views import ViewComparison
from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.core.drawing import new_figure, png, style
from vialight.optics.viewing import vial_edge_columns

if TYPE_CHECKING:
    pass

FOUND, BEFORE = "#c0501a", "#18348f"
"""Colours of what a calibration found, and of what the rig had before."""


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


def mirror_png(before: ViewComparison, after: ViewComparison, angles_deg: FloatArray) -> bytes:
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


def _middle(compared: ViewComparison) -> FloatArray:
    return np.asarray(compared.differences[:, :, compared.differences.shape[2] // 2], dtype=np.float64)
