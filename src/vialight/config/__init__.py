"""The rig: what is known of vial, resin, camera, projector and stage, read from TOML and checked.

A rig is data: frozen, validated when read, with unknown keys refused.  A command asks for the tables that it needs;
what it does not need may be absent.
"""

from vialight.config.conditions import ThresholdConditions
from vialight.config.instruments import CameraSettings, ProjectorSettings, StageSettings
from vialight.config.optics import Optics
from vialight.config.reading import changed_rig, load_rig, parse_toml, read_toml
from vialight.config.rig import (
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
    "changed_rig",
    "load_rig",
    "parse_toml",
    "read_toml",
]
