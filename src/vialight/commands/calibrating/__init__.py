"""Calibrate: each command finds values of the rig and writes a new one, with a page that shows whether it is right."""

from vialight.commands.calibrating.resin import calibrate_resin

__all__ = ["calibrate_resin"]
