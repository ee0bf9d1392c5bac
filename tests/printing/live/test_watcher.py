"""The live measurement's processes, as the print asks after them."""

from __future__ import annotations

import multiprocessing
import threading
import time
from pathlib import Path
from typing import Any

import pytest

from printing.prints import recorded_rig
from vialight.core.arrays import Grid
from vialight.core.messages import StopForecast
from vialight.printing.live.following import LiveSettings
from vialight.printing.live.sharing import SharedVolume
from vialight.printing.live.talking import FAULT, READY, faults_told_to
from vialight.printing.live.watcher import LiveWatcher, Name
from vialight.system.mailboxes import Mailbox


class SlowPipe:
    """A connection with one message, which takes its time to say so; a second reader would wait for ever."""

    def __init__(self) -> None:
        self.messages = [READY]

    def poll(self) -> bool:
        there = bool(self.messages)
        time.sleep(0.05)
        return there

    def recv_bytes(self) -> bytes:
        return self.messages.pop()

    def close(self) -> None:
        pass


@pytest.fixture
def watcher(tmp_path: Path) -> LiveWatcher:
    return LiveWatcher(LiveSettings(tmp_path, tmp_path, recorded_rig(), 880.0, 30))


def test_watcher_that_has_not_been_started_has_no_fault(watcher: LiveWatcher) -> None:
    assert watcher.fault() is None
    assert not watcher.is_ready()
    assert not watcher.has_ended()


def test_threads_that_ask_at_once_hear_the_same(watcher: LiveWatcher) -> None:
    pipes: dict[Name, Any] = {"follower": SlowPipe(), "analyst": SlowPipe()}
    watcher._orders = pipes
    heard: list[bool] = []
    threads = [threading.Thread(target=lambda: heard.append(watcher.is_ready())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(5.0)
    assert heard == [True] * 4


def test_forecast_of_a_measurement_that_was_started_again_takes_the_place_of_the_old_one(tmp_path: Path) -> None:
    watcher = LiveWatcher(LiveSettings(tmp_path, tmp_path, recorded_rig(), 880.0, 30))
    assert watcher.forecast() is None
    with Mailbox(tmp_path / "forecast", StopForecast, 2**14) as before:
        before.put(StopForecast(100.0, 1.0, "seen"))
        assert watcher.forecast() == StopForecast(100.0, 1.0, "seen")
    with Mailbox(tmp_path / "forecast", StopForecast, 2**14) as again:
        assert watcher.forecast() is None
        again.put(StopForecast(90.0, 1.0, "seen anew"))
        assert watcher.forecast() == StopForecast(90.0, 1.0, "seen anew")


def test_process_that_finds_no_memory_says_so_in_its_errors_own_words(tmp_path: Path) -> None:
    """As in a container with a small place in memory: the print tells it before there is light."""
    ours, theirs = multiprocessing.Pipe()
    grid = Grid((4000, 4000, 4000), 0.05)
    with faults_told_to(theirs):
        SharedVolume.make(tmp_path / "volume", grid, (slice(0, 1), slice(0, 1), slice(0, 1)))
    told = ours.recv_bytes()
    assert told.startswith(FAULT)
    assert b"has no room for" in told
    assert b"docker run --shm-size" in told
    ours.close()
    theirs.close()
