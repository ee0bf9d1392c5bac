"""A plan played through devices, recorded, watched and brought to its end: start reading at `session`.

- `track`: where the stage is at any moment
- `light`: its one owner, who gives leave to the projector only while everything is well
- `recorder`: every frame on disk before it counts
- `preflight`: what is checked before the first light
- `doubts`: what makes the calibration doubtful, which is told
- `settings`, `watching`: how to print, and what is asked of who measures it
- `session`: the order of it all
- `sweeping`: patterns one after the other, for calibration
"""

from vialight.printing.doubts import doubts_of_background, doubts_of_rig
from vialight.printing.light import LightOwner, LightRules
from vialight.printing.log import EventLog
from vialight.printing.recorder import Recorder
from vialight.printing.session import print_plan
from vialight.printing.settings import PrintSettings, stop_settings
from vialight.printing.sweeping import SweepFrames, record_sweep
from vialight.printing.track import StageFollower, StageTrack
from vialight.printing.watching import Watcher

__all__ = [
    "EventLog",
    "LightOwner",
    "LightRules",
    "PrintSettings",
    "Recorder",
    "StageFollower",
    "StageTrack",
    "SweepFrames",
    "Watcher",
    "doubts_of_background",
    "doubts_of_rig",
    "print_plan",
    "record_sweep",
    "stop_settings",
]
