"""Figures of the resin, as PNG."""

from __future__ import annotations

import numpy as np

from vialight.calibration.resin.working_curve import WorkingCurve
from vialight.core.arrays import FloatArray
from vialight.core.drawing import new_figure, png, style


def working_curve_png(curve: WorkingCurve) -> bytes:
    """Draw cured depths over exposure, with the line that was fitted."""
    from matplotlib.ticker import FuncFormatter

    exposure = np.geomspace(curve.critical_mj_per_cm2, 1.3 * curve.exposure_mj_per_cm2.max(), 100)
    with style():
        figure = new_figure(7.2, 4.2)
        axis = figure.add_subplot()
        axis.semilogx(exposure, curve.depth_at(exposure), color="#18348f", linewidth=1.2, label="fitted")
        axis.semilogx(curve.exposure_mj_per_cm2, curve.depth_mm, "o", color="#c0501a", markersize=5, label="measured")
        axis.axvline(
            curve.critical_mj_per_cm2, color="#5d6778", linewidth=0.8, linestyle=":", label="critical exposure"
        )
        axis.set_xlabel("exposure at the surface, mJ/cm²")
        axis.set_ylabel("cured depth, mm")
        axis.set_ylim(bottom=0)
        for ticks in (axis.xaxis.set_major_formatter, axis.xaxis.set_minor_formatter):
            ticks(FuncFormatter(lambda value, _: f"{value:g}"))
        axis.grid(linewidth=0.3)
        axis.legend(frameon=False)
        return png(figure)


def gel_doses_png(gel_time_s: FloatArray, dose_mj_per_cm2: FloatArray, critical_mj_per_cm2: float) -> bytes:
    """Draw the doses at which places gelled, over when they did, and their histogram."""
    with style():
        figure = new_figure(7.6, 3.6)
        over, histogram = figure.subplots(1, 2, sharey=True, width_ratios=(2, 1))
        over.plot(gel_time_s, dose_mj_per_cm2, ".", color="#18348f", markersize=5)
        histogram.hist(dose_mj_per_cm2, bins=40, orientation="horizontal", color="#18348f", alpha=0.8)
        for axis in (over, histogram):
            axis.axhline(critical_mj_per_cm2, color="#c0501a", linewidth=1, label=f"median {critical_mj_per_cm2:.4g}")
            axis.grid(linewidth=0.3)
        over.set(xlabel="gelled after, s", ylabel="dose until then, mJ/cm²")
        over.set_ylim(0, 1.25 * float(dose_mj_per_cm2.max()))
        over.legend(frameon=False)
        histogram.set_xlabel("places")
        return png(figure)
