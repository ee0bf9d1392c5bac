"""A projector that hangs is ended by its guardian, whatever becomes of the cover."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from vialight.devices import (
    DeviceError,
    DeviceGoneError,
    Lease,
    LightPhase,
    MonotonicClock,
    ProjectorParts,
    ProjectorProcess,
)
from vialight.devices.panel import LightPanel
from vialight.system import wait_for

pytestmark = pytest.mark.alone


class HangingScreen:
    """A screen whose driver does not come back."""

    refresh_hz = 60.0

    def show(self, pattern: int | None) -> None:
        pass

    def tend(self) -> None:
        time.sleep(60.0)

    def close(self) -> None:
        pass


class BrokenCover:
    """A cover that cannot be drawn."""

    def cover(self) -> None:
        raise RuntimeError("the window system is gone")

    def tend(self) -> None:
        pass

    def close(self) -> None:
        pass


def test_projector_that_hangs_is_ended_also_where_no_cover_can_be_drawn(tmp_path: Path) -> None:
    parts = ProjectorParts(HangingScreen, BrokenCover, np.zeros(1), tmp_path / "log.csv")
    projector = ProjectorProcess(parts, MonotonicClock(), tmp_path)
    try:
        projector.renew(Lease(LightPhase.LIT, time.monotonic() + 60.0, 0.0, 0.0, 0.0, float("inf")))
        assert wait_for(lambda: LightPanel(tmp_path).is_dark_for_good, timeout_s=2.0) is None
        assert wait_for(lambda: not projector.processes["projector"].is_alive(), timeout_s=2.0) is None
        with pytest.raises(DeviceGoneError, match=r"no sign of life for 0\.15 s"):
            projector.shown()
    finally:
        projector.close()


def test_projector_that_hangs_in_the_dark_without_leave_is_let_be_and_holds_the_light(tmp_path: Path) -> None:
    """A computer that is busy while a print starts must not end it."""
    parts = ProjectorParts(HangingScreen, BrokenCover, np.zeros(1), tmp_path / "log.csv")
    projector = ProjectorProcess(parts, MonotonicClock(), tmp_path)
    try:
        time.sleep(1.0)
        assert projector.processes["projector"].is_alive()
        assert not LightPanel(tmp_path).is_dark_for_good
        with pytest.raises(DeviceError, match="has given no sign of life") as told:
            projector.shown()
        assert not isinstance(told.value, DeviceGoneError)
    finally:
        projector.close()
