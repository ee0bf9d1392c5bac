"""Projectors by their drivers: `window` is what there is."""

from __future__ import annotations

from pathlib import Path

from vialight.core.arrays import FloatArray
from vialight.core.config import Projector as ProjectorTable
from vialight.core.config import ProjectorSettings
from vialight.devices.projecting import ProjectorParts, ProjectorProcess
from vialight.devices.projectors.levels import read_flat_field
from vialight.devices.projectors.monitors import Monitor, check_size, list_monitors
from vialight.devices.protocols import Clock

__all__ = ["Monitor", "check_size", "list_monitors", "open_projector", "told_of_projector"]


def open_projector(
    table: ProjectorTable,
    clock: Clock,
    plan_path: Path | None,
    angles_rad: FloatArray,
    rig_folder: Path,
    folder: Path,
    log: Path,
) -> ProjectorProcess:
    """Draw the curtain, and open the projector's window over it.

    Parameters
    ----------
    table
        The rig's.
    clock
        The print's.
    plan_path
        For the patterns; without, there is one, and it is white.
    angles_rad
        (angle,) of the patterns.
    rig_folder
        In which paths of the rig begin.
    folder
        For mailboxes.
    log
        CSV file of what was due and shown.

    Raises
    ------
    DeviceError
        No window can be opened that shows patterns as they are.
    """
    from vialight.devices.projectors.cover import WindowCoverMaker
    from vialight.devices.projectors.curtain import draw_curtain
    from vialight.devices.projectors.window import WindowMaker

    settings = table.settings or ProjectorSettings()
    size = (table.columns, table.rows)
    draw_curtain(settings.monitor, size)
    parts = ProjectorParts(
        WindowMaker(table, plan_path, rig_folder),
        WindowCoverMaker(settings.monitor, size),
        angles_rad,
        log,
        settings.latency_s,
    )
    return ProjectorProcess(parts, clock, folder)


def told_of_projector(table: ProjectorTable, rig_folder: Path) -> list[str]:
    """Return what a person should know before there is light: what a flat field costs, and that the curtain stays."""
    told = ["a black curtain stays over the projector's monitor after the print; Escape, typed into it, takes it away"]
    settings = table.settings or ProjectorSettings()
    if settings.flat_field is not None:
        kept = read_flat_field(rig_folder / settings.flat_field, (table.rows, table.columns))
        told.append(
            f"the flat field takes {100 * (1 - kept.max()):.0f} to {100 * (1 - kept.min()):.0f} % of the light, "
            f"{100 * (1 - kept.mean()):.0f} % on average; irradiance_mw_per_cm2 must be what it leaves"
        )
    return told
