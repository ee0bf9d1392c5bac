"""The parallel-beam Radon transform of stacks of slices: ramp filters and backprojection.

A ray is the line ``x cos(psi) - y sin(psi) = s`` of the object frame.  Arrays keep z innermost, so that the index and
the weight of a pixel are computed once and applied to a whole column of slices.  `filters` has the ramps, `level` and
`climbing` backproject whole sinograms, `projecting` makes them.
"""

from vialight.tomography.radon.climbing import backproject_tilted
from vialight.tomography.radon.filters import FilterName, filter_rays, fold, ramp_filter
from vialight.tomography.radon.level import backproject
from vialight.tomography.radon.projecting import project_tilted

__all__ = ["FilterName", "backproject", "backproject_tilted", "filter_rays", "fold", "project_tilted", "ramp_filter"]
