"""Stages by their drivers: `pi` is what there is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from vialight.core.config import Stage as StageTable
from vialight.devices.protocols import Clock, Stage

if TYPE_CHECKING:
    from vialight.devices.stages.pi import PiStage


def reach_stage(table: StageTable, clock: Clock) -> PiStage:
    """Reach the stage of a rig's table, and leave it as it is: it can be asked, and does not move.

    Raises
    ------
    InputError
        Its settings do not suit it.
    DeviceError
        It cannot be reached, or its driver is not installed.
    """
    from vialight.devices.stages.pi import PiStage

    return PiStage(table.settings, clock)


def open_stage(table: StageTable, clock: Clock) -> Stage:
    """Open the stage of a rig's table, ready to turn; it may move to its reference first.

    Raises
    ------
    InputError
        Its settings do not suit it.
    DeviceError
        It cannot be reached or does not get ready, or its driver is not installed.
    """
    return reach_stage(table, clock).prepared()


__all__ = ["open_stage", "reach_stage"]
