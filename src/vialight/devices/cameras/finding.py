"""Which camera is meant, of those that answer."""

from __future__ import annotations

from typing import NamedTuple

from vialight.devices.protocols import DeviceError


class FoundCamera(NamedTuple):
    """A camera that answers."""

    driver: str
    model: str
    """With its vendor."""
    serial: str
    address: str
    """On its network or bus; empty where it has none."""
    identifier: str
    """By which the driver opens it."""
    protocol: str

    def __str__(self) -> str:
        return f"{self.model}, serial number {self.serial}" + (f", at {self.address}" if self.address else "")


def choose_camera(found: list[FoundCamera], device: str | None) -> FoundCamera:
    """Return the camera that a rig means by its serial number, address or identifier; None means the only one.

    Raises
    ------
    DeviceError
        It is not there, or not the only one.

    Examples
    --------
    >>> there = [FoundCamera("aravis", "Maker M1", "17", "192.168.1.9", "Maker-17", "GigEVision")]
    >>> choose_camera(there, "17").identifier, choose_camera(there, None).identifier
    ('Maker-17', 'Maker-17')
    """
    others = "; found: " + "; ".join(map(str, found)) if found else "; no camera was found"
    if device is None:
        if len(found) == 1:
            return found[0]
        if not found:
            raise DeviceError("camera", "none was found", "check power, cable and network; see vialight devices")
        raise DeviceError("camera", f"{len(found)} were found{others}", "name one: [camera.settings] device")
    for one in found:
        if device in (one.serial, one.address, one.identifier):
            return one
    raise DeviceError(f"camera {device}", f"was not found{others}", "check [camera.settings] device, power and cable")
