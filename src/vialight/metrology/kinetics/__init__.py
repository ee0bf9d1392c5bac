"""A print over time: what dose came where, when matter gelled, and where and when the print began to fail.

- `shown_light`: what light a run got
- `dose`: what dose that light brought to a place
- `gel_times`: when each voxel gelled for good
- `failures`: where and when the print began to fail
"""

from vialight.metrology.kinetics.dose import ShownPatterns, dose_over_time, doses_over_time, mj_per_cm2
from vialight.metrology.kinetics.failures import Failure, InsideHistory, outside_failures, stalled_failures
from vialight.metrology.kinetics.gel_times import GelTimes

__all__ = [
    "Failure",
    "GelTimes",
    "InsideHistory",
    "ShownPatterns",
    "dose_over_time",
    "doses_over_time",
    "mj_per_cm2",
    "outside_failures",
    "stalled_failures",
]
