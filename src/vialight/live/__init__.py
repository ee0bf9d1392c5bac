"""Frames in, snapshots out: the print measured while it forms."""
