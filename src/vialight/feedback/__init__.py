"""Stage: when a print is done.

- `model`: what is believed before the print of when each place cures, and when the light should go off
- `history`: what has been seen to cure, and when
- `prediction`: the two compared, and the moment at which to stop
- `lateness`: where a print fell behind its rehearsal

Everything here is in *lit* time: seconds for which the projector has shown patterns.  It stands still while the light
is off, as it may be after a fault, and so does curing, but for what the dark cure adds.
"""

from vialight.feedback.history import StopHistory, fresh_history, observe, places, sample
from vialight.feedback.lateness import Lateness, lateness
from vialight.feedback.model import FEWEST_TURNS, Doubt, StopModel
from vialight.feedback.prediction import StopPrediction, predict, should_stop

__all__ = [
    "FEWEST_TURNS",
    "Doubt",
    "Lateness",
    "StopHistory",
    "StopModel",
    "StopPrediction",
    "fresh_history",
    "lateness",
    "observe",
    "places",
    "predict",
    "sample",
    "should_stop",
]
