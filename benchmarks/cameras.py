"""Stream from Aravis' GigE Vision camera in software, over loopback, for a minute at each rate.

    python benchmarks/cameras.py

Prints what stands in ``docs/hardware.md``.  The camera stamps its frames with the system's wall clock, so that the
times which the driver gives can be compared with the true ones.  Needs ``make system devices``.

The port of such a camera is fixed.  Where the system lets every rate have a network of its own, all stream at once.
"""

from __future__ import annotations

import argparse
import fcntl
import json
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from vialight.core.config import CameraSettings
from vialight.devices import MonotonicClock
from vialight.devices.cameras import GenicamCamera
from vialight.devices.cameras.aravis import AravisLink
from vialight.devices.cameras.links import RawFrame

RATES_HZ = (10.0, 30.0)
SETTINGS = CameraSettings(device="127.0.0.1", pixel_format="Mono16", region=(0, 0, 480, 300), exposure_s=0.01)
SETTLED_S = 2.0
MOST = (2.5, 97.5)
"""Percentiles between which 95 % lie."""
_APART = ["unshare", "--map-root-user", "--net"]
_GET_FLAGS, _SET_FLAGS, _IS_UP = 0x8913, 0x8914, 1


class Witness(AravisLink):
    """A link that notes stamps and arrivals as they come."""

    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings)
        self.stamps_s: list[float] = []
        self.arrivals_s: list[float] = []
        self.wall_ahead_s: list[float] = []

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        """Return the next buffer."""
        frame = super().next_frame(timeout_s)
        if frame is not None and frame.stamp_s is not None:
            self.stamps_s.append(frame.stamp_s)
            self.arrivals_s.append(time.monotonic())
            self.wall_ahead_s.append(time.time() - self.arrivals_s[-1])  # the system may be setting its clock
        return frame


def main() -> None:
    """Print the table, or JSON."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--json", action="store_true")
    parser.add_argument("--rate", type=float, help="of one camera, in this process")
    asked = parser.parse_args()
    if asked.rate is not None:
        print(json.dumps(streamed(asked.rate, asked.seconds)))
        return
    rows = all_streamed(asked.seconds)
    print(json.dumps(rows) if asked.json else table(rows))


def all_streamed(seconds: float) -> list[dict[str, Any]]:
    """Stream at each rate, at once where that can be."""
    can_be_apart = (
        shutil.which(_APART[0]) is not None
        and subprocess.run([*_APART, "true"], capture_output=True, check=False).returncode == 0
    )
    command = [*(_APART if can_be_apart else []), sys.executable, __file__, "--seconds", str(seconds)]
    running = []
    for rate_hz in RATES_HZ:
        running.append(subprocess.Popen([*command, "--rate", str(rate_hz)], stdout=subprocess.PIPE))
        if not can_be_apart:
            running[-1].wait()
    return [json.loads(process.communicate()[0]) for process in running]


def streamed(rate_hz: float, seconds: float) -> dict[str, Any]:
    """Stream at a rate, and say how it went."""
    _set_loopback_up()
    # The tests' cameras take turns by the same file.
    with (Path(tempfile.gettempdir()) / f"vialight-gvcp-{_network()}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        with subprocess.Popen(["arv-fake-gv-camera-0.8", "-i", "127.0.0.1"], stdout=subprocess.DEVNULL) as process:
            try:
                time.sleep(1.0)
                return _taken(rate_hz, seconds)
            finally:
                process.kill()


def _taken(rate_hz: float, seconds: float) -> dict[str, Any]:
    link = Witness(SETTINGS)
    camera = GenicamCamera(lambda: link, SETTINGS, MonotonicClock())
    try:
        camera.start(rate_hz)
        numbers, times_s, most = [], [], 0
        for _ in range(int(seconds * rate_hz)):
            frame = camera.next_frame(5.0)
            numbers.append(frame.number)
            times_s.append(frame.time_s)
            most = max(most, int(frame.counts.max()))
    finally:
        camera.close()
    told_s = np.array(times_s)
    true_s = (np.array(link.stamps_s) - link.wall_ahead_s)[: len(told_s)]
    late_ms, error_ms = 1e3 * (np.array(link.arrivals_s[: len(told_s)]) - true_s), 1e3 * (told_s - true_s)
    settled = error_ms[int(SETTLED_S * rate_hz) :]
    return {
        "rate_hz": rate_hz, "numbers": numbers, "shape": frame.counts.shape, "most": most,
        "incomplete": camera.incomplete, "overrun": camera.overrun, "links_lost": camera.links_lost,
        "period_s": float(told_s[-1] - told_s[0]) / (len(told_s) - 1),
        "late_ms": [late_ms.min(), late_ms.max()], "off_ms": [settled.min(), settled.max()],
        "most_off_ms": list(np.percentile(settled[len(settled) // 2 :], MOST)),
    }  # fmt: skip


def table(rows: list[dict[str, Any]]) -> str:
    """Return it in Markdown."""
    lines = ["| asked | frames | lost | a part lost | arrives after | time told, off by |", "| --- " * 6 + "|"]
    for row in rows:
        numbers, late, off = row["numbers"], row["late_ms"], row["off_ms"]
        lost = numbers[-1] + 1 - len(numbers)
        lines.append(
            f"| {row['rate_hz']:g}/s | {len(numbers)} | {lost} | {row['incomplete']} "
            f"| {late[0]:.1f} to {late[1]:.1f} ms | {off[0]:.1f} to {off[1]:.1f} ms |"
        )
    return "\n".join(lines)


def _network() -> int:
    """Return what tells networks of one machine apart."""
    return Path("/proc/self/ns/net").stat().st_ino


def _set_loopback_up() -> None:
    """Switch the loopback on, which a new network has off."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as any_socket:
        name = b"lo".ljust(16, b"\0")
        flags = struct.unpack("16xh", fcntl.ioctl(any_socket, _GET_FLAGS, name + bytes(24))[:18])[0]
        if not flags & _IS_UP:
            fcntl.ioctl(any_socket, _SET_FLAGS, name + struct.pack("h22x", flags | _IS_UP))


if __name__ == "__main__":
    main()
