"""A minute of GigE Vision at 10 and at 30 frames/s: two cameras in software, each on a loopback of its own."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from needs import need_command, need_module

BENCHMARK = Path(__file__).parents[3] / "benchmarks" / "cameras.py"
SECONDS = 60.0
STEADY_MS = 5.0
"""0.1 deg at 20 deg/s."""


def test_a_minute_streams_without_loss_and_with_true_times() -> None:
    """It may run beside other tests: a frame says when it was taken, however late it comes."""
    need_command("arv-fake-gv-camera-0.8", "aravis-tools")
    need_module("gi")
    done = subprocess.run(
        [sys.executable, str(BENCHMARK), "--seconds", str(SECONDS), "--json"],
        capture_output=True, text=True, check=False, timeout=600,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    assert [row["rate_hz"] for row in rows] == [10.0, 30.0]
    for row in rows:
        rate_hz = row["rate_hz"]
        assert row["numbers"] == list(range(int(SECONDS * rate_hz)))
        assert (row["incomplete"], row["overrun"], row["links_lost"]) == (0, 0, 0)
        assert row["shape"] == [300, 480]
        assert row["most"] > 255  # 16 bits are used
        # What remains is the least delay: it is that of the quickest frames, and stays the same once some were quick.
        assert row["off_ms"][0] > -1.0
        lower, upper = row["most_off_ms"]
        assert upper - lower < STEADY_MS
        assert row["period_s"] == pytest.approx(1 / rate_hz, rel=0.02)
