"""What is wrong with a printer, on request."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.store.rig_files import changed_rig, read_toml
from vialight.twin.poses import Pose, VialPose
from vialight.twin.tables import from_table


@dataclass(frozen=True)
class Faults:
    """Faults of stage, lamp, camera, projector and resin; all off by default.

    A wrong index or distance is not among them, as it is no property of the printer: `FaultsFile` has it.

    Parameters
    ----------
    axis_offset_mm
        Lab x and y by which the stage's axis, and the vial on it, lies beside where the rig has it.
    run_out_mm
        Radius of the circle on which the vial's axis goes round the stage's once a turn, from lab x at angle 0.
    tilt_rad
        By which the stage's axis, and the vial, leans towards lab x and y.
    speed_ripple, ripples_a_turn
        Share by which the speed of the stage varies, and how often a turn.
    led_drift_per_s
        Share by which the imaging light changes each second.
    dropped_share
        Of the frames, at random.
    timestamp_jitter_s
        Standard deviation of the time, and so of the angle, that a frame is recorded with.
    specks, speck_mm, speck_counts_per_mm
        Bubbles or dust in the resin: how many, their radius, and how brightly they scatter.
    projector_shift_pixels
        Columns to the right and rows down by which the projector's image is off.
    projector_gain
        Of the projector's light; less than 1 is dimmed.

    Examples
    --------
    >>> Faults(axis_offset_mm=(0.1, 0.0), run_out_mm=0.05).vial(np.pi / 2).shift_mm
    (0.1, 0.05)
    """

    axis_offset_mm: tuple[float, float] = (0.0, 0.0)
    run_out_mm: float = 0.0
    tilt_rad: tuple[float, float] = (0.0, 0.0)
    speed_ripple: float = 0.0
    ripples_a_turn: int = 7
    led_drift_per_s: float = 0.0
    dropped_share: float = 0.0
    timestamp_jitter_s: float = 0.0
    specks: int = 0
    speck_mm: float = 0.15
    speck_counts_per_mm: float = 400.0
    projector_shift_pixels: tuple[float, float] = (0.0, 0.0)
    projector_gain: float = 1.0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("speed_ripple", 0.0, 0.9), ("ripples_a_turn", 1, 1000), ("dropped_share", 0.0, 0.95),
            ("timestamp_jitter_s", 0.0, 1.0), ("led_drift_per_s", -1.0, 1.0), ("projector_gain", 0.0, 100.0),
            ("specks", 0, 10_000), ("speck_mm", 0.01, 5.0), ("speck_counts_per_mm", 0.0, 1e6), ("run_out_mm", 0.0, 5.0),
        ):  # fmt: skip
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError("faults", f"{name} is {value}", accepted=f"{low:g} to {high:g}", remedy="correct it")

    def vial(self, angle_rad: float) -> VialPose:
        """Return how the vial stands when the stage has turned by an angle."""
        (x, y), (out_x, out_y) = self.axis_offset_mm, self._run_out(angle_rad)
        return VialPose((round(x + out_x, 15), round(y + out_y, 15)), self.tilt_rad)

    def pose(self, angle_rad: float) -> Pose:
        """Return how the object stands, in the lab, when it has turned by an angle."""
        return Pose(angle_rad, self.axis_offset_mm, self.tilt_rad)

    def pose_in_vial(self, angle_rad: float) -> Pose:
        """Return how the object stands as seen by one who moves with the vial but does not turn."""
        out_x, out_y = self._run_out(angle_rad)
        return Pose(angle_rad, (-out_x, -out_y))

    def _run_out(self, angle_rad: float) -> tuple[float, float]:
        x, y = self.run_out_mm * np.cos(angle_rad), self.run_out_mm * np.sin(angle_rad)
        return round(float(x), 15), round(float(y), 15)

    def angle(self, time_s: float, speed_rad_s: float) -> float:
        """Return the stage's true angle: even but for the ripple."""
        even = speed_rad_s * time_s
        return float(even + self.speed_ripple / self.ripples_a_turn * np.sin(self.ripples_a_turn * even))

    def specks_in(self, grid: Grid, rng: np.random.Generator) -> Float32Array | None:
        """Return the density (y, x, z) of bubbles and dust, which turn with the resin; None without any."""
        if not self.specks:
            return None
        density = np.zeros((grid.shape[1], grid.shape[2], grid.shape[0]), np.float32)
        for _ in range(self.specks):
            radius, angle = np.sqrt(rng.uniform()) * grid.x_mm[-1], rng.uniform(0, 2 * np.pi)
            place = (radius * np.sin(angle), radius * np.cos(angle), rng.uniform(grid.z_mm[0], grid.z_mm[-1]))
            near = [
                np.exp(-(((axis - at) / self.speck_mm) ** 2))
                for axis, at in zip((grid.y_mm, grid.x_mm, grid.z_mm), place, strict=True)
            ]
            density += (self.speck_counts_per_mm * np.einsum("i,j,k->ijk", *near)).astype(np.float32)
        return density


@dataclass(frozen=True)
class FaultsFile:
    """What a file of faults asks for.

    Parameters
    ----------
    faults
        Of the printer.
    believed
        Tables of a rig with the values that the reconstruction is given in place of the true ones.
    source
        The file, for errors.
    """

    faults: Faults = Faults()
    believed: dict[str, Any] | None = None
    source: str = "faults"

    def rig_as_believed(self, rig: Rig) -> Rig:
        """Return the rig that the reconstruction is given.

        Raises
        ------
        InputError
            A key is unknown to rigs, or a value impossible.
        """
        return changed_rig(rig, self.believed, f"{self.source} [believed]") if self.believed else rig


def load_faults(path: str | Path) -> FaultsFile:
    """Read faults: a TOML file with the fields of `Faults` (angles in degrees) and a table ``[believed]``.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or holds unknown or impossible values.
    """
    table = read_toml(Path(path), accepted="faults in TOML", remedy="check the path")
    believed = table.pop("believed", {})
    if not isinstance(believed, dict):
        raise InputError(path, f"believed is {believed!r}", accepted="tables of a rig", remedy="correct it")
    return FaultsFile(from_table(Faults, table, str(path)), believed, str(path))
