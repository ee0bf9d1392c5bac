"""The picture of a flat target by which a person sees that its points were found, as PNG."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from vialight.calibration.scale.flat_target import TargetView
from vialight.core.arrays import BoolArray, FloatArray
from vialight.core.drawing import new_figure, png, style

_FOUND, _OFF, _LEFT_OUT = "#3fd0c9", "#ff9d57", "#e04848"
_LONGER = 100


def target_png(
    image: FloatArray, views: Sequence[TargetView], left_over: FloatArray | None = None, kept: BoolArray | None = None
) -> bytes:
    """Draw an image (row, column), the points of the one view of it, and how far (point, 2) they are off."""
    rows, columns = image.shape
    with style():
        figure = new_figure(7.2, min(5.9 * rows / columns + 0.7, 7.2))
        axis = figure.add_subplot()
        low, high = np.percentile(image, [0.5, 99.5])
        shown = axis.imshow(image, cmap="gray", vmin=low, vmax=max(high, low + 1), interpolation="nearest")
        figure.colorbar(shown, ax=axis, label="counts", fraction=0.03, pad=0.02)
        for view in views:
            count = len(view.points.rows)
            good = np.ones(count, np.bool_) if kept is None else kept[:count]
            column, row = view.points.columns, view.points.rows
            axis.plot(column[good], row[good], "o", markersize=5, fillstyle="none", color=_FOUND, label="found")
            if not good.all():
                axis.plot(column[~good], row[~good], "x", markersize=5, color=_LEFT_OUT, label="left out")
            if left_over is not None:
                ends = np.stack([column, row], axis=1) + _LONGER * left_over[:count]
                pairs = np.stack([np.stack([column, row], axis=1), ends], axis=1)[good]
                for k, pair in enumerate(pairs):
                    label = None if k else f"left over, {_LONGER} times as long"
                    axis.plot(*pair.T, color=_OFF, linewidth=1, label=label)
        axis.set(xlabel="column", ylabel="row", xlim=(-0.5, columns - 0.5), ylim=(rows - 0.5, -0.5))
        if views:
            figure.legend(loc="outside lower center", ncols=3, facecolor="#8a919c", frameon=True, fontsize="small")
        return png(figure)
