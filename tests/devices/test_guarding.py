"""A projector that hangs is ended by its guardian, whatever becomes of the cover."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

from vialight.devices import DeviceGoneError, MonotonicClock, ProjectorParts, ProjectorProcess
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
        assert wait_for(lambda: LightPanel(tmp_path).is_dark_for_good, timeout_s=2.0) is None
        assert wait_for(lambda: not projector.processes["projector"].is_alive(), timeout_s=2.0) is None
        with pytest.raises(DeviceGoneError, match=r"no sign of life for 0\.15 s"):
            projector.shown()
    finally:
        projector.close()
