"""A physical model of projector, resin and camera that stands in for the hardware.

It traces rays through glass and resin and knows nothing of the closed forms that it is there to test:
``docs/twin.md`` has every equation, constant and unit.
"""

from vialight.twin.exposure import dose_of
from vialight.twin.faults import Faults, FaultsFile, load_faults
from vialight.twin.machine import Frame, Twin
from vialight.twin.playing import Moment, check_that_it_gels, dose_a_turn_mj_per_cm2, grid_round, play
from vialight.twin.presets import ResinModel, find_rig, load_resin, resin_names, rig_file, rig_names
from vialight.twin.settings import TwinSettings, load_settings

__all__ = [
    "Faults",
    "FaultsFile",
    "Frame",
    "Moment",
    "ResinModel",
    "Twin",
    "TwinSettings",
    "check_that_it_gels",
    "dose_a_turn_mj_per_cm2",
    "dose_of",
    "find_rig",
    "grid_round",
    "load_faults",
    "load_resin",
    "load_settings",
    "play",
    "resin_names",
    "rig_file",
    "rig_names",
]
