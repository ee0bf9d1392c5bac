"""Stream from Aravis' GigE Vision camera in software, over loopback, for a minute at each rate.

    python benchmarks/cameras.py

Prints what stands in ``docs/hardware.md``.  The camera stamps its frames with the system's wall clock, so that the
times which the driver gives can be compared with the true ones.  Needs ``make system devices``.
"""

from __future__ import annotations

import argparse
import subprocess
import time

import numpy as np

from vialight.config import CameraSettings
from vialight.devices import CameraFrame, MonotonicClock
from vialight.devices.cameras import GenicamCamera
from vialight.devices.cameras.aravis import AravisLink
from vialight.devices.cameras.links import RawFrame

RATES_HZ = (10.0, 30.0)
SETTINGS = CameraSettings(device="127.0.0.1", pixel_format="Mono16", region=(0, 0, 480, 300), exposure_s=0.01)
SETTLED_S = 2.0


class Witness(AravisLink):
    """A link that notes stamps and arrivals as they come."""

    def __init__(self, settings: CameraSettings) -> None:
        super().__init__(settings)
        self.stamps_s: list[float] = []
        self.arrivals_s: list[float] = []

    def next_frame(self, timeout_s: float) -> RawFrame | None:
        """Return the next buffer."""
        frame = super().next_frame(timeout_s)
        if frame is not None and frame.stamp_s is not None:
            self.stamps_s.append(frame.stamp_s)
            self.arrivals_s.append(time.monotonic())
        return frame


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    print("| asked | frames | lost | a part lost | arrives after | time told, off by |")
    print("| --- | --- | --- | --- | --- | --- |")
    with subprocess.Popen(["arv-fake-gv-camera-0.8", "-i", "127.0.0.1"], stdout=subprocess.DEVNULL) as process:
        try:
            time.sleep(1.0)
            for rate_hz in RATES_HZ:
                print(row(rate_hz, seconds))
        finally:
            process.kill()


def row(rate_hz: float, seconds: float) -> str:
    """Stream at a rate, and say how it went."""
    link = Witness(SETTINGS)
    camera = GenicamCamera(lambda: link, SETTINGS, MonotonicClock())
    try:
        camera.start(rate_hz)
        frames: list[CameraFrame] = [camera.next_frame(5.0) for _ in range(int(seconds * rate_hz))]
        wall_ahead_s = time.time() - time.monotonic()
    finally:
        camera.close()
    true_s = np.array(link.stamps_s[: len(frames)]) - wall_ahead_s
    late_ms = 1e3 * (np.array(link.arrivals_s[: len(frames)]) - true_s)
    error_ms = 1e3 * (np.array([frame.time_s for frame in frames]) - true_s)
    settled = error_ms[int(SETTLED_S * rate_hz) :]
    lost = frames[-1].number + 1 - len(frames)
    counts = f"| {rate_hz:g}/s | {len(frames)} | {lost} | {camera.incomplete} "
    return counts + f"| {late_ms.min():.1f} to {late_ms.max():.1f} ms | {settled.min():.1f} to {settled.max():.1f} ms |"


if __name__ == "__main__":
    main()
