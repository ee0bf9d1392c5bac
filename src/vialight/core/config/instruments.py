"""How the instruments of a rig are reached and set; absent where the twin stands in for them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, field_validator

from vialight.core.config.fields import Finite, Length, NotNegative, Table

Place = Annotated[int, Field(ge=0)]
Size = Annotated[int, Field(ge=1)]


class CameraSettings(Table):
    """A GenICam camera; names and units are those of its standard features, in seconds and decibels.

    What is left out stays as the camera has it.  ``device`` is its serial number, address or identifier, by default
    the only one that is found; ``producer`` the GenTL producer (``.cti``) by which ``harvesters`` reaches it, by
    default all that vendors have installed.  ``region`` is left, top, width, height, in pixels as binned.  ``trigger``
    is ``"software"`` where vialight triggers each frame, ``"line"`` where a signal at ``trigger_line`` does.
    ``latency_s`` goes from the middle of an exposure to the frame's time stamp by the print's clock.
    """

    device: str | None = None
    producer: str | None = None
    exposure_s: Length | None = None
    gain_db: Finite | None = None
    pixel_format: Literal["Mono8", "Mono10", "Mono10p", "Mono12", "Mono12p", "Mono12Packed", "Mono16"] | None = None
    binning: Annotated[int, Field(ge=1)] | None = None
    region: tuple[Place, Place, Size, Size] | None = None
    trigger: Literal["free-running", "software", "line"] = "free-running"
    trigger_line: str = "Line0"
    latency_s: NotNegative = 0.0


class StageSettings(Table):
    """A rotation stage that speaks GCS 2, at ``socket://host:port`` or ``serial:///dev/ttyUSB0?baud=115200``.

    ``reference`` is what its zero is: its reference switch, or ``here``, where it stands, for a stage without one.
    ``latency_s`` goes from when it was at an angle to the middle of the question for it and the answer.
    """

    address: str | None = None
    axis: str = "1"
    reference: Literal["switch", "here"] = "switch"
    latency_s: NotNegative = 0.0


class ProjectorSettings(Table):
    """A projector that shows a window: on which monitor (its index or its name), and what its light does with levels.

    ``linearisation`` are pairs of level, from 0 to 255, and measured irradiance (any unit), both rising; ``flat_field``
    is an image (grey PNG, in the projector's pixels, beside the rig) by which light is multiplied, white being 1.
    ``latency_s`` goes from the refresh from which on a pattern is shown to its light.
    """

    monitor: int | str = 0
    latency_s: NotNegative = 0.0
    linearisation: tuple[tuple[float, float], ...] | None = None
    flat_field: str | None = None

    @field_validator("linearisation")
    @classmethod
    def _rises_over_all_levels(cls, pairs: tuple[tuple[float, float], ...] | None) -> object:
        if pairs is not None:
            steps = [(b[0] - a[0], b[1] - a[1]) for a, b in pairwise(pairs)]
            if not (pairs and pairs[0][0] == 0 and pairs[-1][0] == 255 and all(min(step) > 0 for step in steps)):
                raise ValueError("levels rising from 0 to 255, each with an irradiance that rises too")
        return pairs
