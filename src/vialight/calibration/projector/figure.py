"""The figure of the projector: the glow of lines as seen, as expected, and what is left over."""

from __future__ import annotations

import numpy as np

from vialight.calibration.projector.estimator import ProjectorFit
from vialight.core.drawing import new_figure, png, style


def sweep_png(fit: ProjectorFit) -> bytes:
    """Draw the glow of lines as seen, as expected, and what is left over, line by line along the camera's columns."""
    left = fit.seen - fit.expected
    brightest, most = float(np.nanpercentile(fit.seen, 99)), float(np.nanpercentile(np.abs(left), 99))
    panels = (("seen", fit.seen, "magma", 0.0, brightest), ("expected", fit.expected, "magma", 0.0, brightest),
              ("left over", left, "RdBu_r", -most, most))  # fmt: skip
    with style():
        figure = new_figure(9.6, 3.4)
        for axis, (title, values, colours, low, high) in zip(figure.subplots(1, 3), panels, strict=True):
            axis.set_facecolor("#b8b8b8")
            shown = axis.imshow(values, cmap=colours, vmin=low, vmax=high, aspect="auto", interpolation="nearest")
            axis.set_title(title)
            axis.set_xlabel("camera column")
            figure.colorbar(shown, ax=axis, label="counts", shrink=0.8)
        figure.axes[0].set_ylabel("line")
        return png(figure)
