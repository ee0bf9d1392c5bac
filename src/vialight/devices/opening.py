"""Instruments that a rig names, opened by their drivers, and the printer that they make together.

The libraries of drivers are imported when these are named: each is an optional part.
"""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Self

from vialight.core.arrays import FloatArray
from vialight.core.config import Rig
from vialight.core.errors import InputError, VialightError
from vialight.devices import cameras, projectors, stages
from vialight.devices.clocks import MonotonicClock
from vialight.devices.protocols import Camera, Clock, Devices, Projector, Stage
from vialight.system import shared_folder

DRIVERS = {
    "camera": 'driver = "aravis" or "harvesters"',
    "stage": 'driver = "pi"',
    "projector": 'driver = "window"',
}
"""Table of a rig to the drivers that it may name."""


def names_devices(rig: Rig) -> bool:
    """Say whether a rig names the devices of a printer; without, the twin stands in.

    Raises
    ------
    InputError
        It names some and not others.

    Examples
    --------
    >>> names_devices(Rig())
    False
    """
    named = [name for name in DRIVERS if _driver(rig, name)]
    missing = [name for name in DRIVERS if name not in named]
    if named and missing:
        raise InputError(
            rig.source, f"names a driver for {' and '.join(named)}, none for {' and '.join(missing)}",
            accepted="; ".join(f"[{name}] {DRIVERS[name]}" for name in missing),
            remedy="add it, or remove the others to print on the twin",
        )  # fmt: skip
    return bool(named)


def open_camera(rig: Rig, clock: Clock) -> Camera:
    """Open the camera that a rig names.

    Raises
    ------
    InputError
        The rig names none, or its settings do not suit it.
    DeviceError
        It cannot be reached, or its driver is not installed.
    """
    _need_driver(rig, "camera")
    return cameras.open_camera(rig.need_camera(), clock)


def open_stage(rig: Rig, clock: Clock) -> Stage:
    """Open the stage that a rig names, ready to turn.

    Raises
    ------
    InputError
        The rig names none, or its settings do not suit it.
    DeviceError
        It cannot be reached, or its driver is not installed.
    """
    _need_driver(rig, "stage")
    return stages.open_stage(rig.stage, clock)


class RealPrinter:
    """The camera, the stage and the projector that a rig names.

    Parameters
    ----------
    rig
        It names all three.
    plan_path
        For the patterns, which are loaded here.
    pattern_angles_rad
        (angle,) of the plan's patterns.
    projector_log
        CSV file of what was due and shown.

    Attributes
    ----------
    devices : Devices
        To print with.
    folder : Path
        For mailboxes.
    told : list of str
        What a person should know before the light goes on.

    Raises
    ------
    InputError
        The rig's settings do not suit a device.
    DeviceError
        A device cannot be reached; those that were are let go.
    """

    def __init__(self, rig: Rig, plan_path: Path, pattern_angles_rad: FloatArray, projector_log: Path) -> None:
        clock = MonotonicClock()
        with contextlib.ExitStack() as opened:
            self.folder = shared_folder()
            opened.callback(shutil.rmtree, self.folder, ignore_errors=True)
            camera = open_camera(rig, clock)
            opened.callback(_quietly, camera.close)
            stage = open_stage(rig, clock)
            opened.callback(_quietly, stage.close)
            projector = _open_projector(rig, clock, plan_path, pattern_angles_rad, self.folder, projector_log)
            opened.callback(_quietly, projector.close)
            self.devices = Devices(clock, camera, stage, projector)
            self.told = projectors.told_of_projector(rig.need_projector(), Path(rig.source).parent)
            self._opened = opened.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def write_truth(self, path: Path) -> None:
        """Write nothing: what has truly gelled is known of simulated printers only."""

    def close(self) -> None:
        """Let go of all devices, the light first."""
        self._opened.close()


def _open_projector(
    rig: Rig, clock: Clock, plan_path: Path, angles_rad: FloatArray, folder: Path, log: Path
) -> Projector:
    _need_driver(rig, "projector")
    rig_folder = Path(rig.source).parent
    return projectors.open_projector(rig.need_projector(), clock, plan_path, angles_rad, rig_folder, folder, log)


def _driver(rig: Rig, table: str) -> str | None:
    driver: str | None = getattr(getattr(rig, table), "driver", None)
    return driver


def _need_driver(rig: Rig, table: str) -> None:
    if _driver(rig, table) is None:
        raise InputError(f"{rig.source} [{table}]", "names no driver", accepted=DRIVERS[table], remedy="add it")


def _quietly(close: Callable[[], None]) -> None:
    """Close a device; one that is gone must not keep the others from being closed."""
    with contextlib.suppress(VialightError, OSError):
        close()
