"""`vialight devices` and `vialight doctor`: what is connected, and whether it does what the rig asks."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from devices.cameras.fake import ADDRESS, fake_camera
from devices.gcs2 import Controller, served_over_tcp
from vialight.cli import main
from vialight.commands.doctor_findings import DoctorFinding, frame_findings, monitor_findings, session_findings
from vialight.devices import CameraFrame
from vialight.devices.projectors import Monitor
from vialight.store import open_frames

pytestmark = pytest.mark.alone

FULL = 4095
SPEED_DEG_S = 20.0


def frames(
    count: int = 30, rate_hz: float = 10.0, level: int = 1000, jitter_s: float = 0.0, without: tuple[int, ...] = ()
) -> list[CameraFrame]:
    rng = np.random.default_rng(0)
    return [
        CameraFrame(np.full((20, 30), level, np.uint16), 5.0 + k / rate_hz + rng.uniform(-jitter_s, jitter_s), k)
        for k in range(count)
        if k not in without
    ]


def told(findings: list[DoctorFinding]) -> list[tuple[str, str]]:
    return [(one.state, one.told) for one in findings]


def test_frames_that_are_as_they_should_be_are_one_good_finding() -> None:
    assert told(frame_findings(frames(), 10.0, FULL, SPEED_DEG_S)) == [
        ("ok", "30 frames at 10/s, none lost, times even to 0.00 ms")
    ]


@pytest.mark.parametrize(
    ("case", "message"),
    [
        ({"without": (4, 5, 20)}, "3 of 30 frames were lost"),
        ({"rate_hz": 8.0}, "sends 8 frames/s instead of 10"),
        ({"level": FULL}, "100 % of the pixels are saturated at 4095 counts"),
        ({"level": 12}, "the image is black: at most 12 of 4095 counts"),
        ({"jitter_s": 0.02}, "times of frames are off by up to"),
        ({"count": 2}, "sent 2 frames in 3 s"),
    ],
)
def test_what_is_wrong_with_frames_is_told_alone_and_with_what_to_do(case: dict[str, Any], message: str) -> None:
    (finding,) = frame_findings(frames(**case), 10.0, FULL, SPEED_DEG_S)
    assert finding.state == "wrong"
    assert finding.told.startswith(message)
    assert finding.remedy


def test_a_monitor_must_have_the_projectors_pixels_and_be_as_quick() -> None:
    monitor = Monitor(1, "DLP", 1024, 768, 60)
    assert told(monitor_findings(monitor, 1024, 768, 32.0)) == [("ok", "monitor 1: DLP, 1024 x 768 at 60 Hz")]
    assert "would scale" in monitor_findings(monitor, 912, 1140, 32.0)[0].told
    scaled = Monitor(1, "DLP", 1024, 768, 60, "X11 draws 2 x 2 of its pixels on each of the monitor")
    assert "xrandr --output DLP --scale 1x1" in monitor_findings(scaled, 1024, 768, 32.0)[0].told
    assert "is slower than frame_rate_hz 120" in monitor_findings(monitor, 1024, 768, 120.0)[0].told


def test_a_session_that_may_scale_unseen_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    assert session_findings() == []
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert told(session_findings())[0][0] == "note"


@pytest.fixture(scope="module")
def controller() -> Controller:
    """Of a stage that does not know where it is."""
    return Controller()


@pytest.fixture(scope="module")
def rig_path(controller: Controller, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A rig whose camera and stage are there, on real transports."""
    path: Path = tmp_path_factory.mktemp("doctor") / "rig.toml"
    with fake_camera(), served_over_tcp(controller) as address:
        path.write_text(
            f"""
geometry = "parallel"
[camera]
pixel_mm = 0.1
axis_column = 239.5
optical_row = 149.5
driver = "aravis"
[camera.settings]
device = "{ADDRESS}"
pixel_format = "Mono16"
region = [0, 0, 480, 300]
exposure_s = 0.01
[stage]
speed_deg_s = 120.0
driver = "pi"
[stage.settings]
address = "{address}"
""",
            encoding="utf-8",
        )
        yield path


def run(*arguments: object) -> tuple[int, dict[str, Any]]:
    done = CliRunner().invoke(main, [*map(str, arguments), "--json"])
    assert done.stdout, done.stderr
    return done.exit_code, json.loads(done.stdout)


def test_doctor_moves_nothing_unless_it_may(
    rig_path: Path, controller: Controller, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rig = tmp_path / "rig.toml"
    text = rig_path.read_text(encoding="utf-8")
    rig.write_text("[stage]" + text.split("[stage]")[1], encoding="utf-8")
    _, result = run("doctor", rig)
    stage = [one for one in result["findings"] if one["device"] == "stage"]
    assert [one["state"] for one in stage] == ["ok", "note"]
    assert stage[1]["told"] == "was not turned; it does not know where it is"
    assert "--move" in stage[1]["remedy"]
    asked = {line.split()[0] for line in controller.heard if line.strip() and not line.split()[0].endswith("?")}
    assert asked <= {"HLT"}  # the order to stand still
    assert not controller.is_referenced


def test_doctor_finds_a_camera_and_a_stage_on_real_transports(
    rig_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    _, result = run("doctor", rig_path, "--rate", 20, "--move")
    findings = result["findings"]
    assert {one["device"]: one["state"] for one in findings if one["state"] != "wrong"} == {
        "camera": "ok", "stage": "ok", "disk": "ok", "projector": "note",
    }  # fmt: skip
    assert findings[0]["told"] == "Aravis Fake V01 sends 480 x 300 pixels"
    # This camera's own picture reaches the full level, and its timer is that of a busy machine.
    wrong = [one["told"] for one in findings if one["state"] == "wrong"]
    assert all("saturated" in one or "times of frames" in one or "frames/s" in one for one in wrong), wrong
    (turning,) = [one["told"] for one in findings if "turns at" in one["told"]]
    assert float(turning.split()[2]) == pytest.approx(120.0, rel=0.01)
    assert list(tmp_path.iterdir()) == []


def test_doctor_says_what_does_not_fit_and_ends_with_1(
    rig_path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    text = rig_path.read_text(encoding="utf-8").replace("axis_column = 239.5", "axis_column = 2500.0")
    rig = tmp_path / "rig.toml"
    rig.write_text(text.replace("[0, 0, 480, 300]", "[0, 0, 5000, 300]").split("[stage]")[0], encoding="utf-8")
    code, result = run("doctor", rig)
    assert code == 1
    assert result["is_well"] is False
    wrong = [one["told"] for one in result["findings"] if one["state"] == "wrong"]
    assert "Width is 2048 instead of 5000" in wrong
    assert "axis_column 2500 lies outside the image of 2048 x 300 pixels" in wrong
    rig.write_text(text.replace(ADDRESS, "4711"), encoding="utf-8")
    code, result = run("doctor", rig)
    assert code == 1
    assert "camera 4711: was not found; found: Aravis Fake, serial number V01" in result["findings"][0]["told"]


def test_a_rig_without_drivers_is_the_twins_and_well() -> None:
    code, result = run("doctor", "orth2022-190")
    assert code == 0
    assert {one["state"] for one in result["findings"]} == {"note"}


def test_record_takes_frames_and_angles_from_both(rig_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "frames.h5"
    code, result = run("record", "--rig", rig_path, "--out", out, "--turns", 0.5, "--rate", 20, "--dark", 3)
    assert code == 0
    assert (result["is_complete"], result["dark_frames"], result["frames_missed"]) == (True, 3, 0)
    assert result["camera"] == "Aravis Fake V01"
    with open_frames(out) as recorded:
        assert recorded.shape[1:] == (300, 480)
        assert recorded.time_s is not None
        speed = np.polyfit(recorded.time_s, np.degrees(recorded.angles_rad), 1)[0]
    assert abs(speed) == pytest.approx(120.0, rel=0.01)


def test_devices_lists_cameras_with_the_lines_that_name_them(rig_path: Path) -> None:
    code, result = run("devices")
    assert code == 0
    (camera,) = [one for one in result["cameras"] if one["driver"] == "aravis"]
    assert camera["rig"] == ["[camera]", 'driver = "aravis"', "[camera.settings]", 'device = "V01"']
    text = CliRunner().invoke(main, ["devices"]).stdout
    assert "Aravis Fake, serial number V01, GigEVision" in text
    assert '      device = "V01"' in text
