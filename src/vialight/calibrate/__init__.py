"""What a calibration finds: estimators, arrays in, values with their standard uncertainties out."""

from vialight.calibrate.axis import AxisFit, find_axis, rows_to_compare
from vialight.calibrate.bending import bend_rad, usual_widths
from vialight.calibrate.circles import Circle
from vialight.calibrate.consistency import AXIS, DRIFT, OUT_X, OUT_Y, TILT, Comparison, Views
from vialight.calibrate.edges import track_edges
from vialight.calibrate.findings import Finding, Findings
from vialight.calibrate.height_maps import circle_in_heights
from vialight.calibrate.projector import ProjectorFit, Sweep, fit_projector, line_columns
from vialight.calibrate.resin_index import IndexFit, index_from_cylinders
from vialight.calibrate.scale import EdgeScale, scale_from_edges
from vialight.calibrate.surface_threshold import SurfaceThreshold, surface_threshold
from vialight.calibrate.threshold import (
    Overhead,
    RimThreshold,
    overhead,
    radius_at,
    rim_threshold,
    weighted_mean,
)
from vialight.calibrate.vial import VialFit, bend_left, find_vial
from vialight.calibrate.views import check_something_cured, check_turn, check_unsaturated
from vialight.calibrate.working_curve import WorkingCurve, fit_working_curve
from vialight.calibrate.zero import Turned, turned_since

__all__ = [
    "AXIS",
    "DRIFT",
    "OUT_X",
    "OUT_Y",
    "TILT",
    "AxisFit",
    "Circle",
    "Comparison",
    "EdgeScale",
    "Finding",
    "Findings",
    "IndexFit",
    "Overhead",
    "ProjectorFit",
    "RimThreshold",
    "SurfaceThreshold",
    "Sweep",
    "Turned",
    "VialFit",
    "Views",
    "WorkingCurve",
    "bend_left",
    "bend_rad",
    "check_something_cured",
    "check_turn",
    "check_unsaturated",
    "circle_in_heights",
    "find_axis",
    "find_vial",
    "fit_projector",
    "fit_working_curve",
    "index_from_cylinders",
    "line_columns",
    "overhead",
    "radius_at",
    "rim_threshold",
    "rows_to_compare",
    "scale_from_edges",
    "surface_threshold",
    "track_edges",
    "turned_since",
    "usual_widths",
    "weighted_mean",
]
