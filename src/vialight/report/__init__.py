"""The report and the plan's page: HTML files that hold everything, to be read now and in ten years."""

from vialight.report.colours import colour_limit_mm, deviation_colours
from vialight.report.page import Figure, Provenance, write_report
from vialight.report.plan_page import write_plan_page
from vialight.report.timelapse import picture_of, write_timelapse

__all__ = [
    "Figure",
    "Provenance",
    "colour_limit_mm",
    "deviation_colours",
    "picture_of",
    "write_plan_page",
    "write_report",
    "write_timelapse",
]
