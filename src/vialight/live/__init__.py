"""Frames in, snapshots out: the print measured while it forms.

- `window`, `turn`, `schedule`: the volume of the latest turn, renewed with every frame
- `analysis`: what about once a second is measured on it
- `following`, `analysing`: the two processes that do so; `sharing` hands the volume from one to the other
- `watcher`: both as one thing
- `looking_back`: a recording, read again by the same window
"""

from vialight.live.following import LiveSettings
from vialight.live.looking_back import LOOKS_A_TURN, Place, SeenAgain, see_again, times_of
from vialight.live.sharing import Moment, SharedVolume
from vialight.live.watcher import LiveWatcher
from vialight.live.window import SlidingWindow

__all__ = [
    "LOOKS_A_TURN",
    "LiveSettings",
    "LiveWatcher",
    "Moment",
    "Place",
    "SeenAgain",
    "SharedVolume",
    "SlidingWindow",
    "see_again",
    "times_of",
]
