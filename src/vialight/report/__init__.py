"""The report: one HTML file that holds everything, to be read now and in ten years."""

from vialight.report.colours import colour_limit_mm, deviation_colours
from vialight.report.page import Figure, Provenance, write_report

__all__ = ["Figure", "Provenance", "colour_limit_mm", "deviation_colours", "write_report"]
