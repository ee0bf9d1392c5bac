"""Whether the calibration of a run is still good."""
