"""Tomographic volumetric printing, measured while it cures."""

import os
from importlib.metadata import version

__version__ = version("vialight")

# Numba's threads wait for each other with GNU OpenMP, by default spinning: beside other busy processes, as in a live
# print, that took ten times as long, and as much of the processor.  It is read when the first of them starts.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
