"""What is connected to this machine that a rig can name."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from vialight.devices import DeviceError
from vialight.devices.cameras import list_cameras
from vialight.devices.projectors import list_monitors


def find_instruments() -> dict[str, Any]:
    """Look for cameras, serial ports and monitors.

    Returns
    -------
    dict
        ``cameras``, ``serial_ports`` and ``monitors``, each a list with the ``rig`` lines that name it, and
        ``unable``: what could not be looked for, and why.  That is no fault: nobody needs every driver.
    """
    cameras, unable = list_cameras()
    return {
        "cameras": [camera._asdict() | {"rig": _camera_rig(camera.driver, camera.serial)} for camera in cameras],
        "serial_ports": _unless_unable(_serial_ports, "serial ports", unable),
        "monitors": _unless_unable(_monitors, "window", unable),
        "unable": unable,
    }


def _camera_rig(driver: str, serial: str) -> list[str]:
    return ["[camera]", f'driver = "{driver}"', "[camera.settings]", f'device = "{serial}"']


def _monitors() -> list[dict[str, Any]]:
    return [
        {"index": one.index, "name": one.name, "columns": one.columns, "rows": one.rows, "refresh_hz": one.refresh_hz,
         "rig": ["[projector]", f"columns = {one.columns}", f"rows = {one.rows}", 'driver = "window"',
                 "[projector.settings]", f"monitor = {one.index}"]}
        for one in list_monitors()
    ]  # fmt: skip


def _serial_ports() -> list[dict[str, Any]]:
    try:
        from serial.tools.list_ports import comports
    except ImportError as error:
        raise DeviceError("pi", f"cannot look for serial ports ({error})", "pip install 'vialight[pi]'") from error
    return [
        {"port": port.device, "description": port.description or "",
         "rig": ["[stage]", 'driver = "pi"', "[stage.settings]", f'address = "serial://{port.device}?baud=115200"']}
        for port in comports()
    ]  # fmt: skip


def _unless_unable(look: Callable[[], list[dict[str, Any]]], name: str, unable: dict[str, str]) -> list[dict[str, Any]]:
    try:
        return look()
    except DeviceError as error:
        unable[name] = str(error)
        return []
