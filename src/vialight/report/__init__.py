"""The report and the pages of plan and calibration: HTML files that hold all, to be read now and in ten years."""

from vialight.report.calibration_page import write_calibration_page, write_check_page
from vialight.report.colours import colour_limit_mm, deviation_colours
from vialight.report.growth import growth_figure
from vialight.report.kinetics_figures import GelPlanes, gel_times_png, kinetics_png
from vialight.report.page import Figure, Provenance, write_report
from vialight.report.plan_page import write_plan_page
from vialight.report.timelapse import picture_of, write_timelapse

__all__ = [
    "Figure",
    "GelPlanes",
    "Provenance",
    "colour_limit_mm",
    "deviation_colours",
    "gel_times_png",
    "growth_figure",
    "kinetics_png",
    "picture_of",
    "write_calibration_page",
    "write_check_page",
    "write_plan_page",
    "write_report",
    "write_timelapse",
]
