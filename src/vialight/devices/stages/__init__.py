"""Stages by their drivers: `pi` is what there is."""

from __future__ import annotations

from vialight.config import Stage as StageTable
from vialight.devices.protocols import Clock, Stage


def open_stage(table: StageTable, clock: Clock) -> Stage:
    """Open the stage of a rig's table, ready to turn; it may move to its reference first.

    Raises
    ------
    InputError
        Its settings do not suit it.
    DeviceError
        It cannot be reached or does not get ready, or its driver is not installed.
    """
    from vialight.devices.stages.pi import PiStage

    return PiStage(table.settings, clock).prepared()


__all__ = ["open_stage"]
