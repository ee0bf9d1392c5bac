"""Which printer a rig names, and what is said where that does not add up."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.devices import DeviceError, MonotonicClock, ProjectorParts, ProjectorProcess
from vialight.devices.opening import names_devices, open_camera, open_stage
from vialight.devices.projectors import list_monitors

pytestmark = pytest.mark.alone

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


@pytest.mark.parametrize(("module", "extra"), [("pipython", "pi"), ("glfw", "window"), ("moderngl", "window")])
def test_driver_whose_library_is_not_installed_says_what_to_install(
    module: str, extra: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, module, None)
    opened = (lambda: open_stage(rig_naming("stage"), MonotonicClock())) if extra == "pi" else list_monitors
    with pytest.raises(DeviceError, match=rf"needs {module}; install it: pip install 'vialight\[{extra}\]'"):
        opened()


class ClosedScreen:
    """A screen that someone closes at once."""

    refresh_hz = 60.0

    def show(self, pattern: int | None) -> None:
        pass

    def tend(self) -> None:
        raise DeviceError("projector", "its window was closed")

    def close(self) -> None:
        pass


class NoCover:
    """What a guardian draws over it."""

    def cover(self) -> None:
        pass

    def tend(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_projector_process_says_why_it_has_ended(tmp_path: Path) -> None:
    parts = ProjectorParts(ClosedScreen, NoCover, np.zeros(1), tmp_path / "log.csv")
    projector = ProjectorProcess(parts, MonotonicClock(), tmp_path)
    projector.processes["projector"].join(10.0)
    with pytest.raises(DeviceError, match=r"^projector: its window was closed$"):
        projector.shown()
    projector.close()
