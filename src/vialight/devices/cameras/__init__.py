"""Cameras by GenICam: `genicam` is what all of them do, a link (`aravis`, `harvesters`) how one is reached."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from vialight.core.config import Camera as CameraTable
from vialight.core.config import CameraSettings
from vialight.devices.cameras.aravis import AravisLink, list_aravis_cameras
from vialight.devices.cameras.features import Rounded
from vialight.devices.cameras.finding import FoundCamera
from vialight.devices.cameras.genicam import GenicamCamera
from vialight.devices.cameras.harvesters import HarvestersLink, list_harvesters_cameras
from vialight.devices.cameras.links import Link
from vialight.devices.protocols import Clock, DeviceError

__all__ = ["FoundCamera", "GenicamCamera", "Rounded", "list_cameras", "open_camera"]

_LINKS: Mapping[str, Callable[[CameraSettings], Link]] = {"aravis": AravisLink, "harvesters": HarvestersLink}
_LISTS: Mapping[str, Callable[[], list[FoundCamera]]] = {
    "aravis": list_aravis_cameras,
    "harvesters": list_harvesters_cameras,
}


def open_camera(table: CameraTable, clock: Clock) -> GenicamCamera:
    """Open the camera that a rig names, and set it.

    Parameters
    ----------
    table
        The rig's, with a driver.
    clock
        The print's.

    Raises
    ------
    DeviceError
        What drives it is not installed; it cannot be found; it does not take the settings.
    """
    assert table.driver is not None
    settings = table.settings or CameraSettings()
    link = _LINKS[table.driver]
    return GenicamCamera(lambda: link(settings), settings, clock)


def list_cameras() -> tuple[list[FoundCamera], dict[str, str]]:
    """Return the cameras that answer now, and, by driver, why one cannot look for any."""
    found: list[FoundCamera] = []
    unable: dict[str, str] = {}
    for driver, look in _LISTS.items():
        try:
            found += look()
        except DeviceError as error:
            unable[driver] = str(error)
    return found, unable
