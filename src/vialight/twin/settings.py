"""How closely the twin looks, and what it adds to the ideal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from vialight.core.errors import InputError
from vialight.store.rig_files import read_toml
from vialight.twin.faults import Faults
from vialight.twin.sensor import Sensor, StrayLight
from vialight.twin.tables import from_table

_NOT_IN_FILES = frozenset({"binning", "image_shape", "stray", "sensor", "faults", "seed"})
"""Tables of their own, or given elsewhere."""


@dataclass(frozen=True)
class TwinSettings:
    """How closely to look, and what to add.

    Parameters
    ----------
    chemistry_step_s
        Between updates of the cure, and so of what the camera sees.
    blur_mm
        Standard deviation of the projector's point spread, in air, in the plane of the axis; assumed.
    points_a_voxel
        (z, y, x) points at which the dose is evaluated.
    binning, rays_a_side, image_shape
        Of the camera, see `vialight.twin.camera.imager_for`.
    exposure_s, poses_a_frame
        Of the camera; 1 pose freezes the motion, more blur it.
    pupil_radius_mm, pupil_points, focus_mm
        Of the camera's aperture; 1 point is a pinhole.
    projector_pupil_radius_mm, projector_pupil_points
        Of the projector's aperture, focused on the axis in air.
    extinction_mm2
        See `vialight.twin.camera.frames_of`.
    index_rise
        By which the resin's index would be higher at full conversion: bends the camera's rays; 0 leaves them straight.
    stray, sensor, faults
        What is added to the ideal.
    seed
        Of all that is random.
    """

    chemistry_step_s: float = 1.0
    blur_mm: float = 0.05
    points_a_voxel: tuple[int, int, int] = (1, 1, 1)
    binning: int = 1
    rays_a_side: int = 1
    image_shape: tuple[int, int] | None = None
    exposure_s: float = 0.02
    poses_a_frame: int = 1
    pupil_radius_mm: float = 0.0
    pupil_points: int = 1
    focus_mm: float = 0.0
    projector_pupil_radius_mm: float = 0.0
    projector_pupil_points: int = 1
    extinction_mm2: float = 0.0
    index_rise: float = 0.0
    stray: StrayLight = StrayLight()  # noqa: RUF009  frozen
    sensor: Sensor = Sensor()  # noqa: RUF009  frozen
    faults: Faults = Faults()  # noqa: RUF009  frozen
    seed: int = 0

    def __post_init__(self) -> None:
        for name, low, high in (
            ("chemistry_step_s", 0.01, 60.0), ("blur_mm", 0.0, 5.0), ("rays_a_side", 1, 8), ("exposure_s", 1e-5, 10.0),
            ("poses_a_frame", 1, 100), ("pupil_radius_mm", 0.0, 50.0), ("pupil_points", 1, 1000),
            ("projector_pupil_radius_mm", 0.0, 50.0), ("projector_pupil_points", 1, 1000), ("extinction_mm2", 0.0, 1.0),
            ("index_rise", 0.0, 0.5),
        ):  # fmt: skip
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError("twin", f"{name} is {value}", accepted=f"{low:g} to {high:g}", remedy="correct it")


def load_settings(path: str | Path, settings: TwinSettings | None = None) -> TwinSettings:
    """Read how closely to look: a TOML file with the fields of `TwinSettings`, and tables ``[stray]``, ``[sensor]``.

    Parameters
    ----------
    path
        The file.
    settings
        Gives binning, image, faults and seed, which the file does not.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or holds unknown or impossible values.
    """
    table = read_toml(Path(path), accepted="the twin's settings in TOML", remedy="check the path")
    stray = from_table(StrayLight, table.pop("stray", {}), f"{path} [stray]")
    sensor = from_table(Sensor, table.pop("sensor", {}), f"{path} [sensor]")
    read = from_table(TwinSettings, table, str(path), leaving=_NOT_IN_FILES)
    given = settings or TwinSettings()
    kept = {name: getattr(given, name) for name in _NOT_IN_FILES - {"stray", "sensor"}}
    return replace(read, stray=stray, sensor=sensor, **kept)
