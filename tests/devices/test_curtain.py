"""The curtain's process, as far as it can be seen without a monitor."""

from __future__ import annotations

from pathlib import Path

import pytest

from gifts import trapped
from vialight.devices.projectors.curtain import draw_curtain
from vialight.devices.protocols import DeviceError


def test_curtain_runs_no_code_of_the_current_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    marker = trapped(tmp_path)
    (tmp_path / "private").mkdir()
    monkeypatch.chdir(tmp_path)
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONSAFEPATH"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "private"))
    monkeypatch.setattr("vialight.devices.projectors.curtain._START_TIMEOUT_S", 10.0)
    with pytest.raises(DeviceError, match="has no curtain"):
        draw_curtain(0, (640, 480))
    assert not marker.exists()
