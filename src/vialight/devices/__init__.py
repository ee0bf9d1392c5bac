"""Cameras, stages and projectors: contracts, and devices that keep them.  `protocols` is where reading starts."""

from vialight.devices.clocks import MonotonicClock, SimulatedClock
from vialight.devices.leasing import LEASE_S
from vialight.devices.projecting import ProjectorParts, ProjectorProcess
from vialight.devices.protocols import (
    Camera,
    CameraFrame,
    Clock,
    DeviceError,
    DeviceGoneError,
    DeviceLostError,
    Devices,
    DeviceTimeoutError,
    Lease,
    LightPhase,
    Projector,
    Shown,
    Stage,
    StagePosition,
)

__all__ = [
    "LEASE_S",
    "Camera",
    "CameraFrame",
    "Clock",
    "DeviceError",
    "DeviceGoneError",
    "DeviceLostError",
    "DeviceTimeoutError",
    "Devices",
    "Lease",
    "LightPhase",
    "MonotonicClock",
    "Projector",
    "ProjectorParts",
    "ProjectorProcess",
    "Shown",
    "SimulatedClock",
    "Stage",
    "StagePosition",
]
