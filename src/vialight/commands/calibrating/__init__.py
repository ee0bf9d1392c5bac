"""Calibrate: each command finds values of the rig and writes a new one, with a page that shows whether it is right."""

from vialight.commands.calibrating.resin import calibrate_resin
from vialight.commands.calibrating.threshold import Standard, ThresholdOptions, calibrate_threshold

__all__ = ["Standard", "ThresholdOptions", "calibrate_resin", "calibrate_threshold"]
