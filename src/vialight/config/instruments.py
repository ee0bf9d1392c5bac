"""How the instruments of a rig are reached and set; absent where the twin stands in for them."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from vialight.config.fields import Finite, Length, NotNegative, Table

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
    """A projector that shows a window: on which monitor, and what its light does with levels.

    ``linearisation`` are pairs of level and measured irradiance (any unit, rising); ``flat_field`` an image (PNG, in
    the projector's pixels) by which patterns are multiplied, white being 1.
    """

    monitor: int | str = 0
    latency_s: NotNegative = 0.0
    linearisation: tuple[tuple[float, float], ...] | None = None
    flat_field: str | None = None
