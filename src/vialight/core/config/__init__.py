"""The rig: what is known of vial, resin, camera, projector and stage, as checked tables.

A rig is data: frozen, validated, with unknown keys refused; `store.rig_files` reads it from TOML.  A command asks
for the tables that it needs; what it does not need may be absent.
"""

from vialight.core.config.conditions import ThresholdConditions
from vialight.core.config.instruments import CameraSettings, ProjectorSettings, StageSettings
from vialight.core.config.optics import Optics
from vialight.core.config.rig import (
    Calibration,
    Camera,
    Projector,
    Reference,
    Resin,
    Rig,
    RunOut,
    Stage,
    Uncertainty,
    Vial,
)

__all__ = [
    "Calibration",
    "Camera",
    "CameraSettings",
    "Optics",
    "Projector",
    "ProjectorSettings",
    "Reference",
    "Resin",
    "Rig",
    "RunOut",
    "Stage",
    "StageSettings",
    "ThresholdConditions",
    "Uncertainty",
    "Vial",
]
