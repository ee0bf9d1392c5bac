"""Numbers in shared memory are never seen half-written."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from vialight.devices import SimulatedClock
from vialight.devices.clocks import _place

WRITER = """
import sys
from pathlib import Path
from vialight.devices import SimulatedClock
from vialight.devices.clocks import _place

clock = SimulatedClock(Path(sys.argv[1]), rate=4.0)
print("made", flush=True)
while True:
    for _ in range(1000):
        clock.allow_until(1e9)
"""


def test_clock_that_another_process_moves_all_the_time_always_has_its_rate(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [sys.executable, "-c", WRITER, str(tmp_path / "clock")], stdout=subprocess.PIPE, text=True
    )
    try:
        assert process.stdout is not None
        assert process.stdout.readline() == "made\n"
        clock, looks, last_s = SimulatedClock(tmp_path / "clock"), 0, 0.0
        end = time.monotonic() + 2.0
        while time.monotonic() < end:
            assert clock.rate == pytest.approx(4.0)
            now = clock.now_s()
            assert now >= last_s
            looks, last_s = looks + 1, now
        assert looks > 1000
    finally:
        process.kill()
        process.communicate()


def test_clock_whose_writer_was_killed_in_the_middle_of_a_change_holds_up_nobody(tmp_path: Path) -> None:
    clock = SimulatedClock(tmp_path / "clock", rate=4.0)
    clock.allow_until(2.0)
    clock._numbers[_place(int(clock._words[0]) + 1)] = float("nan")  # written, and never said to be the newest
    assert SimulatedClock(tmp_path / "clock").rate == pytest.approx(4.0)
    assert 0.0 <= SimulatedClock(tmp_path / "clock").now_s() <= 2.0
