"""Flashes of the projector's window, seen over GigE Vision by a camera that looks at the same screen."""

from __future__ import annotations

import json
import sys
from functools import partial
from pathlib import Path

import pytest
from click.testing import CliRunner

from calibration.test_latency_command import write_two_turns
from devices.cameras import screen_camera
from devices.cameras.fake import ADDRESS, fake_camera
from devices.xvfb import COLUMNS, ROWS, Xvfb, needs_xvfb
from vialight.calibration.latency import command as latency
from vialight.cli import main
from vialight.store.rig_files import load_rig

pytestmark = [needs_xvfb, pytest.mark.alone]

EXPOSURE_S, HOLD_S = 0.06, 0.04
FLASHES = 6
"""Half as many as usual, for haste, and twice the exposure, so that as many edges fall into one."""
QUICKEST_S = 0.005
"""By which a picture is on its way at least, and a refresh: nothing waits in a queue on a quiet machine."""
RIG = f"""\
[camera]
pixel_mm = 0.2
axis_column = 29.5
optical_row = 0.0
driver = "aravis"
[camera.settings]
device = "{ADDRESS}"
pixel_format = "Mono8"
region = [0, 0, 64, 32]
exposure_s = {EXPOSURE_S}
[projector]
distance_mm = 120.0
pixel_mm = 0.065
columns = {COLUMNS}
rows = {ROWS}
axis_column = 159.5
azimuth_deg = -90.0
driver = "window"
"""


def test_the_delay_from_window_to_picture_is_found(
    screen: Xvfb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Half an exposure, what the camera waits before it sends, and little more."""
    monkeypatch.setattr(latency, "watch_flashes", partial(latency.watch_flashes, count=FLASHES))
    write_two_turns(tmp_path)  # whose camera is 20 ms late
    (tmp_path / "rig.toml").write_text(RIG)
    program = [sys.executable, screen_camera.__file__, str(screen.framebuffer), str(COLUMNS), str(ROWS), str(HOLD_S)]
    with fake_camera(program=program):
        told = CliRunner().invoke(
            main,
            ["calibrate", "latency", str(tmp_path / "forward.h5"), str(tmp_path / "backward.h5"), "--flash", "--rig",
             str(tmp_path / "rig.toml"), "--out", str(tmp_path / "new.toml"), "--json"],
        )  # fmt: skip
    assert told.exit_code == 0, told.output
    rig = load_rig(tmp_path / "new.toml")
    settings, uncertainty = rig.need_projector().settings, rig.uncertainty
    assert settings is not None
    assert uncertainty is not None
    assert uncertainty.projector is not None
    found, doubt = settings.latency_s + 0.02, uncertainty.projector["settings.latency_s"]
    assert doubt < 0.005
    assert -3 * doubt < found - (EXPOSURE_S / 2 + HOLD_S) < QUICKEST_S + 3 * doubt
    assert "flashes were seen" in " ".join(json.loads(told.stdout)["notes"])
