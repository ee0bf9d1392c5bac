"""The rig: what is known of vial, resin, camera, projector and stage, read from TOML and checked.

A rig is data: frozen, validated when read, with unknown keys refused.  A command asks for the tables that it needs;
what it does not need may be absent.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from vialight.errors import InputError

_TURNING_SENSES = {"counter-clockwise": 1, "counterclockwise": 1, "ccw": 1, "clockwise": -1, "cw": -1}

Length = Annotated[float, Field(gt=0, allow_inf_nan=False, strict=True)]
Index = Annotated[float, Field(ge=1, lt=4, strict=True)]
Distance = Annotated[float, Field(gt=0, strict=True)]
Finite = Annotated[float, Field(allow_inf_nan=False, strict=True)]
NotNegative = Annotated[float, Field(ge=0, allow_inf_nan=False, strict=True)]
Direction = Annotated[
    Literal[1, -1],
    BeforeValidator(lambda value: _TURNING_SENSES.get(value, value) if isinstance(value, str) else value),
]


@dataclass(frozen=True)
class Optics:
    """A pupil looking at a vial: all that the course of a ray depends on.

    Parameters
    ----------
    outer_radius_mm, inner_radius_mm
        Radii of the vial's glass; equal where there is no glass.
    wall_index, resin_index
        Refractive indices of glass and resin at the device's wavelength; air is 1.
    distance_mm
        From the pupil to the rotation axis; ``inf`` for a telecentric device.
    """

    outer_radius_mm: float
    inner_radius_mm: float
    wall_index: float
    resin_index: float
    distance_mm: float

    @property
    def field_radius_mm(self) -> float:
        """Largest ``|x_v|`` that any ray reaches, ``min(R / n_r, R_i)``."""
        return min(self.outer_radius_mm / self.resin_index, self.inner_radius_mm)


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)


class Vial(_Table):
    """The glass: outer radius, wall and its index; ``wall_mm = 0`` means no glass."""

    outer_radius_mm: Length
    wall_mm: NotNegative = 0.0
    wall_index: Index = 1.5

    @model_validator(mode="after")
    def _wall_leaves_room(self) -> Vial:
        if self.wall_mm >= self.outer_radius_mm:
            raise ValueError(f"wall_mm {self.wall_mm} is not less than outer_radius_mm {self.outer_radius_mm}")
        return self


class ThresholdConditions(_Table):
    """The imaging conditions that a gelation threshold belongs to."""

    exposure_s: Length | None = None
    gain_db: Finite | None = None
    led_level: Finite | None = None
    binning: Annotated[int, Field(ge=1)] | None = None


class Resin(_Table):
    """The resin: indices at 624 nm (imaging) and 460 nm (writing), absorption at 460 nm (Napierian), threshold I_p.

    ``critical_exposure_mj_per_cm2`` is the light, in the resin, after which it gels.
    """

    name: str = ""
    index_imaging: Index | None = None
    index_writing: Index | None = None
    absorption_per_mm: NotNegative | None = None
    critical_exposure_mj_per_cm2: Length | None = None
    threshold: Length | None = None
    threshold_conditions: ThresholdConditions | None = None


class Camera(_Table):
    """The camera: pupil distance, pixel pitch in the axis plane, and where axis and optical axis meet the image."""

    distance_mm: Distance | None = None
    pixel_mm: Length
    axis_column: Finite
    optical_row: Finite

    def binned(self, binning: int) -> Camera:
        """Return the camera whose pixels are squares of `binning` x `binning` of this one's."""
        column, row = ((position + 0.5) / binning - 0.5 for position in (self.axis_column, self.optical_row))
        return self.model_copy(update={"pixel_mm": self.pixel_mm * binning, "axis_column": column, "optical_row": row})


class Projector(_Table):
    """The projector: a camera run backwards; azimuth is that of its pupil about the axis, 0 at the camera.

    ``axis_column`` and ``optical_row`` (by default the middle row) say where the axis and the optical axis meet its
    image; ``irradiance_mw_per_cm2`` is that of level 255 in air, in the plane of the axis.
    """

    distance_mm: Distance
    pixel_mm: Length
    columns: Annotated[int, Field(ge=1)]
    rows: Annotated[int, Field(ge=1)]
    axis_column: Finite
    optical_row: Finite | None = None
    azimuth_deg: Finite
    frame_rate_hz: Length = 32.0
    irradiance_mw_per_cm2: Length | None = None

    def as_camera(self) -> Camera:
        """Return the camera that would see along the projector's rays."""
        row = (self.rows - 1) / 2 if self.optical_row is None else self.optical_row
        return Camera(
            distance_mm=self.distance_mm, pixel_mm=self.pixel_mm, axis_column=self.axis_column, optical_row=row
        )


class Stage(_Table):
    """The stage: speed, and whether its angles count counter-clockwise seen from above (1) or clockwise (-1)."""

    speed_deg_s: Length = 20.0
    direction: Direction = 1


class Rig(_Table):
    """All that is known of a printer; see ``docs/reference.md`` for every key."""

    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    geometry: Literal["vial", "parallel"] = "vial"
    vial: Vial | None = None
    resin: Resin = Resin()
    camera: Camera | None = None
    projector: Projector | None = None
    stage: Stage = Stage()
    source: Annotated[str, Field(exclude=True, repr=False)] = "rig"

    def need_camera(self) -> Camera:
        """Return the camera's table, or say that it is missing."""
        if self.camera is None:
            raise InputError(
                self.source, "no table [camera]", accepted="pixel_mm, axis_column, optical_row", remedy="add it"
            )
        return self.camera

    def need_projector(self) -> Projector:
        """Return the projector's table, or say that it is missing."""
        if self.projector is None:
            raise InputError(
                self.source, "no table [projector]",
                accepted="distance_mm, pixel_mm, columns, rows, axis_column, azimuth_deg", remedy="add it",
            )  # fmt: skip
        return self.projector

    def imaging_optics(self) -> Optics | None:
        """Return what the camera's rays pass through; None for ``geometry = "parallel"``."""
        if self.geometry == "parallel":
            return None
        distance = self.need_camera().distance_mm
        return self._optics("camera", distance, "index_imaging", self.resin.index_imaging)

    def writing_optics(self) -> Optics | None:
        """Return what the projector's rays pass through; None for ``geometry = "parallel"``."""
        if self.geometry == "parallel":
            return None
        distance = self.need_projector().distance_mm
        return self._optics("projector", distance, "index_writing", self.resin.index_writing)

    def _optics(self, device: str, distance: float | None, index_name: str, index: float | None) -> Optics:
        if self.vial is None:
            raise InputError(
                self.source, "no table [vial]", accepted="outer_radius_mm, wall_mm, wall_index",
                remedy='add it, or set geometry = "parallel" for data without a vial',
            )  # fmt: skip
        if index is None:
            raise InputError(
                self.source, f"[resin] has no {index_name}", accepted="an index from 1 to 4", remedy="add it"
            )
        if distance is None:
            raise InputError(
                self.source,
                f"[{device}] has no distance_mm",
                accepted="a length, or inf for telecentric",
                remedy="add it",
            )
        if distance <= self.vial.outer_radius_mm:
            raise InputError(
                f"{self.source} [{device}]", f"distance_mm {distance} puts the pupil inside the vial",
                accepted=f"more than outer_radius_mm, {self.vial.outer_radius_mm}", remedy="measure it from the axis",
            )  # fmt: skip
        inner = self.vial.outer_radius_mm - self.vial.wall_mm
        return Optics(self.vial.outer_radius_mm, inner, self.vial.wall_index, index, distance)


def load_rig(path: str | Path) -> Rig:
    """Read and check a rig file.

    Raises
    ------
    InputError
        The file is missing, is not TOML, or holds unknown, missing or impossible values.
    """
    table = read_toml(Path(path), accepted="a rig in TOML", remedy="check the path")
    if "source" in table:
        raise InputError(path, "unknown key source", remedy="remove it")
    return _checked(table, str(path))


def changed_rig(rig: Rig, changes: Mapping[str, Any], where: str) -> Rig:
    """Return a rig with other values, checked as if read from a file.

    Parameters
    ----------
    rig
        What is not changed.
    changes
        Tables of a rig file with the keys that differ.
    where
        Named in errors.

    Raises
    ------
    InputError
        A key is unknown, or a value impossible.

    Examples
    --------
    >>> changed_rig(Rig(), {"stage": {"speed_deg_s": 24.0}}, "faults.toml").stage
    Stage(speed_deg_s=24.0, direction=1)
    """
    table = rig.model_dump(by_alias=True, exclude_none=True)
    for key, value in changes.items():
        both = isinstance(value, Mapping) and isinstance(table.get(key), Mapping)
        table[key] = table[key] | value if both else value
    return _checked(table, where)


def read_toml(source: Path | Traversable, *, accepted: str, remedy: str, name: object = None) -> dict[str, Any]:
    """Read a TOML file.

    Parameters
    ----------
    source
        The file.
    accepted, remedy
        What was expected, and what to do where it is not there; for errors.
    name
        What the user calls the file; by default its path.

    Raises
    ------
    InputError
        The file is missing or is not TOML.
    """
    name = source if name is None else name
    try:
        return tomllib.loads(source.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(name, f"cannot be read ({error.strerror})", accepted=accepted, remedy=remedy) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(name, f"is not TOML ({error})", accepted=accepted, remedy="see docs/reference.md") from error


def _checked(table: Mapping[str, Any], where: str) -> Rig:
    try:
        return Rig.model_validate({**table, "source": where})
    except ValidationError as error:
        raise _explain(where, error) from error


def _explain(path: str, error: ValidationError) -> InputError:
    fault = error.errors()[0]
    *tables, key = [str(part) for part in fault["loc"]] or ["rig"]
    where = f"{path} [{'.'.join(tables)}]" if tables else path
    model: object = Rig
    for table in tables:
        model = _field(model, table)
    if fault["type"] == "extra_forbidden":
        names = ", ".join(_keys(model))
        return InputError(where, f"unknown key {key}", accepted=names, remedy="correct or remove it")
    if fault["type"] == "missing":
        return InputError(where, f"key {key} is missing", accepted=", ".join(_keys(model)), remedy="add it")
    if fault["type"] == "model_type":
        return InputError(
            where, f"{key} is {fault['input']!r}", accepted=f"a table of {', '.join(_keys(_field(model, key)))}"
        )
    value = fault["input"]
    return InputError(
        where, f"{key} is {value!r}", accepted=fault["msg"].removeprefix("Input should be "), remedy="correct it"
    )


def _field(model: object, key: str) -> object:
    return _model(model).model_fields[key].annotation


def _keys(model: object) -> list[str]:
    return [field.alias or name for name, field in _model(model).model_fields.items() if name != "source"]


def _model(annotation: object) -> type[BaseModel]:
    """Return the table that an annotation such as ``Vial | None`` allows."""
    for candidate in (annotation, *getattr(annotation, "__args__", ())):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    raise TypeError(annotation)
