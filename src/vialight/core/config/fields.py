"""What a value of a rig may be, and what all of its tables have in common."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field

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


class Table(BaseModel):
    """A table of the rig: frozen, and without keys that are not known."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=False)
