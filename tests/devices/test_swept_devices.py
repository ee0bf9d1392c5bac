"""`vialight calibrate projector` on real transports: a window's lines, a stage over TCP, and a GigE Vision camera.

What the camera sends is what the twin's camera sees glow of the line that is on the screen.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from devices.cameras.fake import ADDRESS, fake_camera
from devices.gcs2 import Controller, served_over_tcp
from devices.xvfb import COLUMNS, ROWS, Xvfb, needs_xvfb
from vialight.calibration.projector import command as projector
from vialight.calibration.projector.command import SweepOptions
from vialight.cli import main
from vialight.commands.calibrate import calibrate_projector
from vialight.core.config import Rig
from vialight.store import open_frames, rig_to_toml
from vialight.store.rig_files import changed_rig, load_rig
from vialight.twin import find_rig, load_resin

pytestmark = [needs_xvfb, pytest.mark.alone]

LINES = 12
"""For haste."""
SPEED_DEG_S = 72.0
SHAPE = (24, 88)
DARK, BRIGHTEST = 20, 220
_CAMERA = f"import sys; sys.path.insert(0, {str(Path(__file__).parents[1])!r}); " + (
    "from devices.cameras.glowing_camera import main; main()"
)


def rig_of_twin() -> Rig:
    """The paper's printer with as few pixels as the tests' screen has, and half as many of the camera's."""
    changes = {
        "camera": {"pixel_mm": 0.31, "axis_column": 43.5, "optical_row": 11.5},
        "projector": {"columns": COLUMNS, "rows": ROWS, "pixel_mm": 0.208, "axis_column": 159.5},
        "stage": {"speed_deg_s": SPEED_DEG_S},
    }
    return changed_rig(load_resin("DUDMA").in_vial_of(find_rig("orth2022-190")), changes, "test")


def with_instruments(rig: Rig, stage_address: str) -> Rig:
    """The same, which believes the projector 3 columns off and on the camera's other side."""
    settings = {"device": ADDRESS, "pixel_format": "Mono8", "region": (0, 0, SHAPE[1], SHAPE[0]), "exposure_s": 0.003}
    changes = {
        "camera": {"driver": "aravis", "settings": settings},
        "stage": {"driver": "pi", "settings": {"address": stage_address}},
        "projector": {"driver": "window", "axis_column": 156.5, "azimuth_deg": 88.0, "settings": {"monitor": "screen"}},
    }
    return changed_rig(rig, changes, "test")


def test_a_sweep_of_opened_devices_finds_the_projector(
    screen: Xvfb, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(projector, "LINES", LINES)
    rig = rig_of_twin()
    (tmp_path / "twin.toml").write_text(rig_to_toml(rig))
    seen_by_twin = calibrate_projector(tmp_path / "twin.toml", tmp_path / "by-twin.toml", options=SweepOptions())
    with open_frames(tmp_path / "by-twin.sweep.h5") as frames:
        dark = frames.dark()
        assert dark is not None
        glow, first = frames.read(slice(None)) - dark, frames.settings["sweep"]["first_columns"]
    glow = np.clip(np.rint(DARK + glow * (BRIGHTEST - DARK) / glow.max()), 0, 255).astype(np.uint8)
    np.savez(tmp_path / "glow.npz", first_columns=first, glow=glow, dark=np.full(SHAPE, DARK, np.uint8))
    program = [
        sys.executable,
        "-c",
        _CAMERA,
        str(screen.framebuffer),
        str(COLUMNS),
        str(ROWS),
        str(tmp_path / "glow.npz"),
    ]
    controller = Controller()
    with fake_camera(program=program), served_over_tcp(controller) as address:
        (tmp_path / "rig.toml").write_text(rig_to_toml(with_instruments(rig, address)))
        told = CliRunner().invoke(
            main,
            ["calibrate", "projector", "--rig", str(tmp_path / "rig.toml"), "--out", str(tmp_path / "new.toml"),
             "--json"],
        )  # fmt: skip
    assert told.exit_code == 0, told.output
    assert screen.is_black()
    new = load_rig(tmp_path / "new.toml")
    found, known = new.need_projector(), new.uncertainty
    assert known is not None
    assert known.projector is not None
    for value, true, std in (
        (found.axis_column, 159.5, known.projector["axis_column"]),
        (found.pixel_mm, 0.208, known.projector["pixel_mm"]),
        (found.azimuth_deg, -90.0, known.projector["azimuth_deg"]),
    ):
        assert abs(value - true) < 3 * std
    result = json.loads(told.stdout)
    assert any("are mirrored" in note for note in result["notes"])
    # The two differ by noise, the steps of eight bits, and by which rays each fit compares.
    by_twin = {one["key"]: one["value"] for one in seen_by_twin["found"]}
    assert abs(found.axis_column - by_twin["axis_column"]) < 2 * known.projector["axis_column"]
    assert abs(found.azimuth_deg - by_twin["azimuth_deg"]) < 2 * known.projector["azimuth_deg"]
