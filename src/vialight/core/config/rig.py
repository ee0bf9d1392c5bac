"""The rig's tables: what is known of vial, resin, camera, projector and stage."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from vialight.core.config.conditions import ThresholdConditions
from vialight.core.config.fields import Direction, Distance, Finite, Index, Length, NotNegative, Table
from vialight.core.config.instruments import CameraSettings, ProjectorSettings, StageSettings
from vialight.core.config.optics import Optics
from vialight.core.errors import InputError


class Vial(Table):
    """The glass: outer radius, wall and its index; ``wall_mm = 0`` means no glass."""

    outer_radius_mm: Length
    wall_mm: NotNegative = 0.0
    wall_index: Index = 1.5

    @model_validator(mode="after")
    def _wall_leaves_room(self) -> Vial:
        if self.wall_mm >= self.outer_radius_mm:
            raise ValueError(f"wall_mm {self.wall_mm} is not less than outer_radius_mm {self.outer_radius_mm}")
        return self


class Resin(Table):
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


class Camera(Table):
    """The camera: pupil distance, pixel pitch in the axis plane, and where axis and optical axis meet the image.

    ``axis_tilt_deg`` is by how much the axis leans to the right in the image, about the optical row; ``led_level`` the
    light that it sees by, in any unit that is proportional to it; ``driver`` and ``settings`` say how the camera is
    reached, absent for the twin's.
    """

    distance_mm: Distance | None = None
    pixel_mm: Length
    axis_column: Finite
    optical_row: Finite
    axis_tilt_deg: Finite | None = None
    led_level: Length | None = None
    driver: Literal["aravis", "harvesters"] | None = None
    settings: CameraSettings | None = None

    def binned(self, binning: int) -> Camera:
        """Return the camera whose pixels are squares of `binning` x `binning` of this one's."""
        column, row = ((position + 0.5) / binning - 0.5 for position in (self.axis_column, self.optical_row))
        return self.model_copy(update={"pixel_mm": self.pixel_mm * binning, "axis_column": column, "optical_row": row})


class Projector(Table):
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
    driver: Literal["window"] | None = None
    settings: ProjectorSettings | None = None

    def as_camera(self) -> Camera:
        """Return the camera that would see along the projector's rays."""
        row = (self.rows - 1) / 2 if self.optical_row is None else self.optical_row
        return Camera(
            distance_mm=self.distance_mm, pixel_mm=self.pixel_mm, axis_column=self.axis_column, optical_row=row
        )


class RunOut(Table):
    """The circle on which the vial's axis goes round the axis of rotation, once a turn.

    ``phase_deg`` is the direction, in the object's frame, in which the vial's axis lies off the axis of rotation.
    """

    radius_mm: NotNegative
    phase_deg: Finite


class Stage(Table):
    """The stage: speed, and whether its angles count counter-clockwise seen from above (1) or clockwise (-1).

    ``driver`` and ``settings`` say how the stage is reached, absent for the twin's.
    """

    speed_deg_s: Length = 20.0
    direction: Direction = 1
    run_out: RunOut | None = None
    driver: Literal["pi"] | None = None
    settings: StageSettings | None = None


class Uncertainty(Table):
    """Standard uncertainties of a rig's values, by table and key, in the value's own unit.

    A key of an inner table is ``"run_out.radius_mm"``.
    """

    vial: dict[str, NotNegative] | None = None
    resin: dict[str, NotNegative] | None = None
    camera: dict[str, NotNegative] | None = None
    projector: dict[str, NotNegative] | None = None
    stage: dict[str, NotNegative] | None = None

    @model_validator(mode="after")
    def _names_values_of_the_rig(self) -> Uncertainty:
        for name, table in (("vial", Vial), ("resin", Resin), ("camera", Camera), ("projector", Projector),
                            ("stage", Stage)):  # fmt: skip
            if unknown := {key.partition(".")[0] for key in getattr(self, name) or ()} - set(table.model_fields):
                raise ValueError(f"{name} has no key {', '.join(sorted(unknown))}")
        return self


class Calibration(Table):
    """How a calibration found its values: when, from which file (SHA-256), and in words."""

    date: str
    file: str = ""
    sha256: str = ""
    method: str = ""


class Reference(Table):
    """What a run looked like that was good: sharpness and brightness, with which later runs are compared.

    ``streak_columns``, ``streak_counts`` and ``streak_middle_column`` are width (standard deviation), sum and middle of
    the light at the vial's edges, ``edge_columns`` is how soft the part's sharpest edges were; ``conditions`` what
    they belong to.
    """

    streak_columns: Length | None = None
    streak_counts: Length | None = None
    streak_middle_column: Finite | None = None
    edge_columns: Length | None = None
    conditions: ThresholdConditions | None = None


class Rig(Table):
    """All that is known of a printer; see ``docs/reference.md`` for every key."""

    schema_: Annotated[Literal[1], Field(alias="schema")] = 1
    geometry: Literal["vial", "parallel"] = "vial"
    vial: Vial | None = None
    resin: Resin = Resin()
    camera: Camera | None = None
    projector: Projector | None = None
    stage: Stage = Stage()
    uncertainty: Uncertainty | None = None
    calibration: dict[str, Calibration] | None = None
    reference: Reference | None = None
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

    def imaged_under(self, recorded: Mapping[str, Any] | None = None, binning: int = 1) -> ThresholdConditions:
        """Return the conditions of a recording: what itself says, else what the camera is set to.

        Parameters
        ----------
        recorded
            Settings that a recording states.
        binning
            Of its pixels, for what is reconstructed.
        """
        settings = None if self.camera is None else self.camera.settings
        known = {"led_level": None if self.camera is None else self.camera.led_level}
        known |= {} if settings is None else settings.model_dump(include={"exposure_s", "gain_db", "binning"})
        known |= {key: value for key, value in (recorded or {}).items() if key in ThresholdConditions.model_fields}
        try:
            return ThresholdConditions.model_validate(known | {"binning": (known.get("binning") or 1) * binning})
        except (TypeError, ValidationError) as error:
            raise InputError("the recording's settings", f"cannot be used ({error})", remedy="record again") from error

    def threshold_under(self, actual: ThresholdConditions) -> float | None:
        """Return the gelation threshold under some conditions; None where the rig has none.

        Raises
        ------
        InputError
            The threshold's conditions are stated, but the actual ones are not known.
        """
        conditions = self.resin.threshold_conditions
        if self.resin.threshold is None or conditions is None:
            return self.resin.threshold
        return self.resin.threshold * conditions.factor_to(actual, self.source)

    def need_threshold(self, actual: ThresholdConditions | None = None) -> float:
        """Return the resin's gelation threshold, under other conditions if told, or say that it is missing."""
        threshold = self.resin.threshold if actual is None else self.threshold_under(actual)
        if threshold is None:
            raise InputError(
                f"{self.source} [resin]", "has no threshold, the density I_p at which it has gelled",
                accepted="counts per mm", remedy="calibrate it, or give --threshold",
            )  # fmt: skip
        return threshold

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
