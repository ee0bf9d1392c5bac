"""Delays of the camera against the stage, and of the projector against both."""
