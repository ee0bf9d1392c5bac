"""Tomographic volumetric printing, measured while it cures."""

import os
from importlib.metadata import version

__version__ = version("vialight")

# Numba's threads wait for each other with GNU OpenMP, by default spinning: beside other busy processes, as in a live
# print, that took ten times as long, and as much of the processor.  It is read when the first of them starts.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")

# Numba takes settings from a file in the current folder, which may be one that was given: not the place of compiled
# code, which it runs.  What the environment says goes before; nothing is Numba's own default.
os.environ.setdefault("NUMBA_CACHE_DIR", "")
