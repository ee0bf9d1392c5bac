"""Calibrate: each command finds values of the rig and writes a new one, with a page that shows whether it is right."""

from vialight.commands.calibrating.axis import calibrate_axis
from vialight.commands.calibrating.checking import check_calibration
from vialight.commands.calibrating.latency import calibrate_latency
from vialight.commands.calibrating.projector import SweepOptions, calibrate_projector
from vialight.commands.calibrating.resin import calibrate_resin
from vialight.commands.calibrating.scale import calibrate_scale
from vialight.commands.calibrating.standards import Standard, StandardOptions
from vialight.commands.calibrating.target import FlatTarget, calibrate_scale_by_target
from vialight.commands.calibrating.threshold import calibrate_threshold
from vialight.commands.calibrating.vial import calibrate_vial

__all__ = [
    "FlatTarget",
    "Standard",
    "StandardOptions",
    "SweepOptions",
    "calibrate_axis",
    "calibrate_latency",
    "calibrate_projector",
    "calibrate_resin",
    "calibrate_scale",
    "calibrate_scale_by_target",
    "calibrate_threshold",
    "calibrate_vial",
    "check_calibration",
]
