"""Numbers in shared memory are never seen half-written."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pytest

from vialight.devices import SimulatedClock

WRITER = """
import sys
from pathlib import Path
from vialight.devices import SimulatedClock

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
