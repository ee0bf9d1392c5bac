"""Cameras, stages and projectors: contracts, and devices that keep them.  `protocols` is where reading starts."""

from vialight.devices.clocks import MonotonicClock, SimulatedClock
from vialight.devices.projecting import LEASE_S, ProjectorProcess
from vialight.devices.protocols import (
    Camera,
    CameraFrame,
    Clock,
    DeviceError,
    DeviceLostError,
    Devices,
    DeviceTimeoutError,
    Lease,
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
    "DeviceLostError",
    "DeviceTimeoutError",
    "Devices",
    "Lease",
    "MonotonicClock",
    "Projector",
    "ProjectorProcess",
    "Shown",
    "SimulatedClock",
    "Stage",
    "StagePosition",
]
