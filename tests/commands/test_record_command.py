"""`vialight record`: a turning thing imaged without printing, by the twin of a rig and by devices."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from printing.prints import quick_rig
from vialight.commands.record import RecordSettings, record_turns
from vialight.core.errors import InputError
from vialight.metrology.surface import isosurface
from vialight.store import open_frames, rig_to_toml
from vialight.store.foreign.meshes import load_mesh
from vialight.store.rig_files import load_rig
from vialight.tomography.reconstruct import Settings, open_scan, reconstruct
from vialight.twin import load_resin

SAMPLE_PART = Path(__file__).parents[2] / "src" / "vialight" / "commands" / "sample" / "part.stl"
RATE_HZ, SPEED_DEG_S = 20.0, 60.0
"""3 deg a frame: with twice as much, where the part's corners come out hangs on where the turn begins."""


@pytest.fixture(scope="module")
def rig_path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path: Path = tmp_path_factory.mktemp("rig") / "rig.toml"
    path.write_text(rig_to_toml(quick_rig(SPEED_DEG_S)), encoding="utf-8")
    return path


@pytest.fixture(scope="module")
def recording(rig_path: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    out: Path = tmp_path_factory.mktemp("record") / "frames.h5"
    told: list[str] = []
    result = record_turns(rig_path, out, settings=RecordSettings(1.0, 4, RATE_HZ), on_step=told.append)
    assert (result["frames_missed"], result["dark_frames"], result["is_complete"]) == (0, 4, True)
    assert result["turns"] == pytest.approx(1.0, abs=0.1)
    assert "taking 4 dark frames: nothing may scatter yet" in told
    return out


def test_a_turn_is_recorded_with_angles_times_and_dark_frames(recording: Path) -> None:
    with open_frames(recording) as frames:
        assert frames.time_s is not None
        steps_deg = np.degrees(np.diff(frames.angles_rad))
        assert abs(np.ptp(frames.angles_rad)) > 2 * np.pi - 1e-6
        np.testing.assert_allclose(np.abs(steps_deg), SPEED_DEG_S * np.diff(frames.time_s), atol=0.05)
        np.testing.assert_allclose(np.diff(frames.time_s), 1 / RATE_HZ, atol=1e-6)
        seen, empty = frames.read(slice(0, 1))[0], frames.dark()
    assert empty is not None
    # The part scatters; before it was put in, nothing did.
    assert float(seen.max()) > 3 * float(empty.max())


def test_what_was_recorded_is_reconstructed_to_what_stood_in_the_vial(recording: Path, rig_path: Path) -> None:
    settings = Settings(voxel_mm=0.31)
    rig = load_rig(rig_path)
    with open_frames(recording) as frames:
        volume = reconstruct(open_scan(frames, rig, settings), settings)
    # An edge that is blurred on both sides alike keeps its place at half of its height.
    half = 0.5 * load_resin("DUDMA").scattering.counts_per_mm
    surface, part = isosurface(volume, half), load_mesh(SAMPLE_PART)
    assert surface.volume_mm3 == pytest.approx(part.volume_mm3, rel=0.05)
    np.testing.assert_allclose(surface.bounds_mm, part.bounds_mm, atol=0.155)  # a pixel


def frames_in(path: Path) -> int:
    try:
        with open_frames(path) as frames:
            return len(frames.angles_rad)
    except InputError:  # not there, or without a frame
        return 0


def test_ctrl_c_keeps_what_there_is(rig_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "frames.h5"
    program = str(Path(sys.executable).with_name("vialight"))
    command = [program, "record", "--rig", str(rig_path), "--out", str(out), "--turns", "50", "--json"]
    # In a group of its own, all of which hears Ctrl-C, as at a terminal.
    process = subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 120.0
        while frames_in(out) < 3:
            assert process.poll() is None, process.communicate()
            assert time.monotonic() < deadline
            time.sleep(0.05)
        os.killpg(process.pid, signal.SIGINT)
        said, heard = process.communicate(timeout=60.0)
    finally:
        process.kill()
    assert process.returncode == 0, heard
    result = json.loads(said)
    assert result["is_complete"] is False
    with open_frames(out) as frames:
        assert len(frames.angles_rad) == result["frames"] > 0


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"turns": 0.0}, "--turns: is 0.0"), ({"dark_frames": -1}, "--dark: is -1"),
        ({"frame_rate_hz": float("nan")}, "--rate"),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_refused(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        RecordSettings(**settings)  # type: ignore[arg-type]


def test_a_recording_is_never_overwritten(rig_path: Path, tmp_path: Path) -> None:
    out = tmp_path / "frames.h5"
    out.write_bytes(b"precious")
    with pytest.raises(InputError, match="exists already"):
        record_turns(rig_path, out)
    assert out.read_bytes() == b"precious"


def test_devices_are_named_all_or_none(rig_path: Path, tmp_path: Path) -> None:
    half = tmp_path / "rig.toml"
    half.write_text(rig_path.read_text().replace("[camera]\n", '[camera]\ndriver = "aravis"\n'), encoding="utf-8")
    with pytest.raises(InputError, match=r"names a driver for \[camera\], none for \[stage\]"):
        record_turns(half, tmp_path / "frames.h5")
    assert not (tmp_path / "frames.h5").exists()
