"""Which printer a rig names, and what is said where that does not add up."""

from __future__ import annotations

from typing import Any

import pytest

from vialight.config import Rig
from vialight.devices import MonotonicClock
from vialight.devices.opening import names_devices, open_camera, open_stage
from vialight.errors import InputError

CAMERA = {"pixel_mm": 0.155, "axis_column": 239.5, "optical_row": 149.5}
PROJECTOR = {
    "distance_mm": 120.0, "pixel_mm": 0.065, "columns": 320, "rows": 240, "axis_column": 159.5, "azimuth_deg": -90.0,
}  # fmt: skip


def rig_naming(*tables: str) -> Rig:
    drivers = {"camera": "aravis", "stage": "pi", "projector": "window"}
    rig: dict[str, Any] = {"camera": dict(CAMERA), "stage": {}, "projector": dict(PROJECTOR)}
    for table in tables:
        rig[table]["driver"] = drivers[table]
    return Rig.model_validate(rig)


def test_rig_with_all_three_drivers_is_a_real_printer_and_one_with_none_the_twin() -> None:
    assert names_devices(rig_naming("camera", "stage", "projector"))
    assert not names_devices(rig_naming())


def test_rig_with_some_of_the_drivers_is_refused_with_what_is_missing() -> None:
    with pytest.raises(InputError, match=r"none for stage; accepted: \[stage\] driver = \"pi\""):
        names_devices(rig_naming("camera", "projector"))
    with pytest.raises(InputError, match=r"none for camera and projector"):
        names_devices(rig_naming("stage"))


def test_opening_a_device_that_the_rig_does_not_name_says_which_drivers_there_are() -> None:
    with pytest.raises(InputError, match=r"\[camera\]: names no driver; accepted: .*aravis"):
        open_camera(rig_naming(), MonotonicClock())
    with pytest.raises(InputError, match=r"\[stage\]: names no driver; accepted: .*pi"):
        open_stage(rig_naming(), MonotonicClock())
