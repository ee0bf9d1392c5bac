"""`vialight calibrate latency`: from two recordings and from flashes, to a new rig."""

from __future__ import annotations

import json
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from calibration.test_latency import SPEED, recorded
from vialight.calibration.latency.command import watch_flashes
from vialight.calibration.latency.estimator import delay_of_flashes
from vialight.cli import main
from vialight.devices import CameraFrame, DeviceTimeoutError, Lease, Shown
from vialight.store import write_frames
from vialight.store.rig_files import load_rig

pytestmark = pytest.mark.alone

RIG = """\
[camera]
pixel_mm = 0.2
axis_column = 29.5
optical_row = 0.0
[camera.settings]
latency_s = 0.01
"""
RATE = 8.0
EXPOSURE_S = 0.04


class FastClock:
    """Wall time, eight times as fast."""

    rate = RATE

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def now_s(self) -> float:
        return RATE * (time.monotonic() - self._begun)


class FlashingInstruments:
    """A projector and a camera that sees it, with known delays; `Camera` and `Projector` at once."""

    image_shape, full_level = (2, 2), 1000

    def __init__(self, clock: FastClock, projector_s: float, camera_s: float) -> None:
        self._clock, self._projector_s, self._camera_s = clock, projector_s, camera_s
        self._shown = [Shown(None, 0.0)]

    def renew(self, lease: Lease) -> None:
        self._show(0)

    def end(self) -> None:
        self.darken()

    def darken(self) -> None:
        self._show(None)

    def _show(self, pattern: int | None) -> None:
        if self._shown[-1].pattern != pattern:
            self._shown.append(Shown(pattern, self._clock.now_s()))

    def shown(self) -> Shown:
        return self._shown[-1]

    def start(self, frame_rate_hz: float) -> None:
        self._period_s, self._number = 1 / frame_rate_hz, 0
        self._next_s = self._clock.now_s() + 0.01

    def next_frame(self, timeout_s: float) -> CameraFrame:
        ready = self._next_s + EXPOSURE_S / 2 + 0.05
        wait = (ready - self._clock.now_s()) / RATE
        time.sleep(max(0.0, min(wait, timeout_s)))
        if wait > timeout_s:
            raise DeviceTimeoutError("camera", "none yet")
        moments = self._next_s + np.linspace(-EXPOSURE_S / 2, EXPOSURE_S / 2, 41)
        lit = np.mean([self._is_lit(moment - self._projector_s) for moment in moments])
        frame = CameraFrame(np.full((2, 2), 50 + 800 * lit, np.uint16), self._next_s + self._camera_s, self._number)
        self._next_s, self._number = self._next_s + self._period_s, self._number + 1
        return frame

    def _is_lit(self, time_s: float) -> bool:
        return [shown for shown in self._shown if shown.since_s <= time_s or shown is self._shown[0]][-1].pattern == 0

    def close(self) -> None:
        pass


def test_flashes_give_the_delays_of_projector_and_camera_together() -> None:
    clock = FastClock()
    instruments = FlashingInstruments(clock, 0.03, 0.012)
    times, means, flashes = watch_flashes(instruments, instruments, clock, count=6)
    assert len(flashes) == 6
    found = delay_of_flashes(times, means, EXPOSURE_S, flashes)
    assert found.value == pytest.approx(0.042, abs=0.01)  # the frames are 100 ms apart
    assert abs(found.value - 0.042) < 4 * found.uncertainty


def write_two_turns(folder: Path) -> None:
    """Write ``forward.h5`` and ``backward.h5``, with a camera 20 ms late."""
    for name, speed, seed in (("forward", SPEED, 1), ("backward", -SPEED, 2)):
        turn = recorded(speed, 0.02, seed)
        images = np.clip(np.rint(turn.images + 20), 0, None).astype(np.uint16)[:, None]
        write_frames(folder / f"{name}.h5", images, turn.angles_rad, time_s=turn.times_s)


def test_two_recordings_give_a_rig_whose_frames_would_have_had_the_same_angles(tmp_path: Path) -> None:
    write_two_turns(tmp_path)
    (tmp_path / "rig.toml").write_text(RIG)
    told = CliRunner().invoke(
        main,
        ["calibrate", "latency", str(tmp_path / "forward.h5"), str(tmp_path / "backward.h5"), "--rig",
         str(tmp_path / "rig.toml"), "--out", str(tmp_path / "new.toml"), "--json"],
    )  # fmt: skip
    assert told.exit_code == 0, told.output
    rig = load_rig(tmp_path / "new.toml")
    settings = rig.need_camera().settings
    assert settings is not None
    assert settings.latency_s == pytest.approx(0.03, abs=1e-3)
    assert rig.uncertainty is not None
    assert "projector was left alone" in " ".join(json.loads(told.stdout)["notes"])
