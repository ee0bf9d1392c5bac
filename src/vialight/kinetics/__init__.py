"""Stage: a print over time: what dose came where, when matter gelled, and where and when it began to fail."""

from vialight.kinetics.dose import Shown, dose_over_time, doses_over_time, mj_per_cm2
from vialight.kinetics.failures import Failure, InsideHistory, outside_failures, stalled_failures
from vialight.kinetics.gel_times import GelTimes

__all__ = [
    "Failure",
    "GelTimes",
    "InsideHistory",
    "Shown",
    "dose_over_time",
    "doses_over_time",
    "mj_per_cm2",
    "outside_failures",
    "stalled_failures",
]
