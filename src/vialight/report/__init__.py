"""The report and the pages of plan and calibration: HTML files that hold all, to be read now and in ten years."""

from vialight.report.calibration_figures import gel_doses_png, sweep_png, working_curve_png
from vialight.report.calibration_page import write_calibration_page, write_check_page
from vialight.report.colours import colour_limit_mm, deviation_colours
from vialight.report.geometry_figures import axis_round_png, bend_png, frame_png, mirror_png
from vialight.report.growth import growth_figure
from vialight.report.kinetics_figures import GelPlanes, gel_times_png, kinetics_png
from vialight.report.page import Figure, Provenance, write_report
from vialight.report.plan_page import write_plan_page
from vialight.report.target_figures import target_png
from vialight.report.threshold_figures import heights_png, rim_png, surface_threshold_png, view_from_above_png
from vialight.report.timelapse import picture_of, write_timelapse

__all__ = [
    "Figure",
    "GelPlanes",
    "Provenance",
    "axis_round_png",
    "bend_png",
    "colour_limit_mm",
    "deviation_colours",
    "frame_png",
    "gel_doses_png",
    "gel_times_png",
    "growth_figure",
    "heights_png",
    "kinetics_png",
    "mirror_png",
    "picture_of",
    "rim_png",
    "surface_threshold_png",
    "sweep_png",
    "target_png",
    "view_from_above_png",
    "working_curve_png",
    "write_calibration_page",
    "write_check_page",
    "write_plan_page",
    "write_report",
    "write_timelapse",
]
