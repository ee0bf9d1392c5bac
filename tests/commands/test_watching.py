"""A replay that cannot go on says so in one line, and ends."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from printing.prints import quick_rig
from vialight.commands import watch as watching
from vialight.core.errors import InputError
from vialight.devices import DeviceError
from vialight.store import FrameWriter, rig_to_toml, write_frames


class Watcher:
    """Stands for the live measurement: ready at once or never, and ends after a while."""

    is_good, lives_s = True, 60.0

    def __init__(self, settings: Any) -> None:
        self.ends_at = float("inf")

    def start(self) -> None:
        self.ends_at = time.monotonic() + self.lives_s

    def is_ready(self) -> bool:
        return self.is_good

    def has_ended(self) -> bool:
        return time.monotonic() > self.ends_at

    def fault(self) -> str | None:
        return "the follower has ended (exit code -9)" if self.has_ended() else None

    def close(self) -> None:
        pass


class FullDisk(FrameWriter):
    """Takes three frames."""

    def append(self, *given: Any) -> None:
        if self.count == 3:
            raise InputError(self.path, "the disk is full (0.0 MB free); 3 frames are safe")
        super().append(*given)


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "run"
    folder.mkdir()
    (folder / "rig.toml").write_text(rig_to_toml(quick_rig(60.0)), encoding="utf-8")
    counts = np.zeros((40, 20, 30), np.uint16)
    write_frames(folder / "frames.h5", counts, 0.1 * np.arange(40), time_s=0.1 * np.arange(40))
    monkeypatch.setattr(watching, "LiveWatcher", Watcher)
    return folder


@pytest.mark.parametrize(("is_good", "what"), [(False, "the live measurement"), (True, "last snapshot|last frame")])
def test_a_replay_whose_watcher_dies_ends_with_one_line(
    run: Path, monkeypatch: pytest.MonkeyPatch, is_good: bool, what: str
) -> None:
    monkeypatch.setattr(Watcher, "is_good", is_good)
    monkeypatch.setattr(Watcher, "lives_s", 0.3)
    begun = time.monotonic()
    with pytest.raises(DeviceError, match=rf"({what}) does not come: the follower has ended"):
        watching.watch_run(run, rate=10.0, threshold=1.0)
    assert time.monotonic() - begun < 10


def test_a_replay_onto_a_full_disk_ends_with_one_line(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(watching, "FrameWriter", FullDisk)
    begun = time.monotonic()
    with pytest.raises(DeviceError, match=r"does not come: disk: .*the disk is full"):
        watching.watch_run(run, rate=10.0, threshold=1.0)
    assert time.monotonic() - begun < 10


def test_run_whose_files_lead_elsewhere_is_not_read(tmp_path: Path) -> None:
    """A folder that somebody gave: what its links point at is not theirs to give."""
    secret = tmp_path / "secret.toml"
    secret.write_text("[vial]\nouter_radius_mm = 12.4\n")
    run = tmp_path / "run"
    run.mkdir()
    for name in ("rig.toml", "frames.h5"):
        (run / name).symlink_to(secret)
        with pytest.raises(InputError, match="leads out of its folder"):
            watching.watch_run(run)
        (run / name).unlink()
        (run / name).write_text("")
