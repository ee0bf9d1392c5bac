"""GigE Vision over a real network stack: Aravis' camera in software streams on loopback, and is killed."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from devices.cameras.fake import ADDRESS, FakeCamera, fake_camera
from vialight.core.config import Camera, CameraSettings
from vialight.core.errors import VialightWarning
from vialight.devices import CameraFrame, DeviceError, DeviceTimeoutError, MonotonicClock
from vialight.devices.cameras import GenicamCamera, list_cameras, open_camera

pytestmark = pytest.mark.alone

SETTINGS = CameraSettings(device=ADDRESS, pixel_format="Mono16", region=(0, 0, 480, 300), exposure_s=0.01)


def table(**settings: Any) -> Camera:
    return Camera(
        pixel_mm=0.1,
        axis_column=239.5,
        optical_row=149.5,
        driver="aravis",
        settings=SETTINGS.model_copy(update=settings),
    )


@pytest.fixture
def fake() -> Iterator[FakeCamera]:
    with fake_camera() as camera:
        yield camera


def test_a_camera_that_was_killed_is_found_again_and_its_numbers_tell_for_how_long(fake: FakeCamera) -> None:
    camera = open_camera(table(), MonotonicClock())
    try:
        camera.start(20.0)
        before = [camera.next_frame(5.0) for _ in range(20)]
        fake.kill()
        while (frame := next_frame(camera)) is not None:
            before.append(frame)
        with pytest.raises(DeviceTimeoutError, match="the link is lost"):
            wait_until_lost(camera)
        fake.start()
        after = next(filter(None, (next_frame(camera) for _ in range(100))))
        later = [camera.next_frame(5.0) for _ in range(20)]
        assert camera.links_lost >= 1
    finally:
        camera.close()
    gone_s = after.time_s - before[-1].time_s
    assert gone_s > 0.5
    assert after.number - before[-1].number == pytest.approx(20.0 * gone_s, abs=3)
    assert [frame.number for frame in later] == list(range(after.number + 1, after.number + 21))


def next_frame(camera: GenicamCamera) -> CameraFrame | None:
    try:
        return camera.next_frame(0.3)
    except DeviceTimeoutError:
        return None


def wait_until_lost(camera: GenicamCamera) -> None:
    """Wait for frames until the camera says why there are none."""
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        try:
            camera.next_frame(0.1)
        except DeviceTimeoutError as error:
            if "no frame within" not in str(error):
                raise


def test_cameras_are_listed_and_one_that_is_not_there_is_told_with_those_that_are(fake: FakeCamera) -> None:
    found, _ = list_cameras()
    (one,) = [camera for camera in found if camera.driver == "aravis"]
    assert (one.model, one.serial, one.address) == ("Aravis Fake", "V01", ADDRESS)
    with pytest.raises(DeviceError, match=r"camera 4711: was not found; found: Aravis Fake, serial number V01"):
        open_camera(table(device="4711"), MonotonicClock())
    camera = open_camera(table(device="V01"), MonotonicClock())
    assert camera.name == "Aravis Fake V01"
    camera.close()


def test_values_that_the_camera_does_not_have_are_told(fake: FakeCamera) -> None:
    with pytest.warns(VialightWarning, match="Width is 2048 instead of 5000"):
        camera = open_camera(table(region=(0, 0, 5000, 300), binning=2), MonotonicClock())
    assert camera.image_shape == (300, 2048)
    camera.close()
    with pytest.raises(DeviceError, match="has no feature Gain; leave it out"):
        open_camera(table(gain_db=3.0), MonotonicClock())
    camera = open_camera(table(exposure_s=0.5), MonotonicClock())
    with pytest.raises(DeviceError, match="at most 2 frames/s at an exposure of 500 ms; asked for 10"):
        camera.start(10.0)
    camera.close()


def test_frames_come_as_the_driver_triggers_them(fake: FakeCamera) -> None:
    camera = open_camera(table(trigger="software", pixel_format="Mono8"), MonotonicClock())
    try:
        camera.start(20.0)
        frames = [camera.next_frame(5.0) for _ in range(30)]
    finally:
        camera.close()
    assert [frame.number for frame in frames] == list(range(30))
    # This camera looks for a trigger only so often, and gives each frame the time at which it did.
    assert (frames[-1].time_s - frames[0].time_s) / 29 == pytest.approx(0.05, rel=0.1)


def test_a_network_that_loses_packets_costs_frames_but_shows_none_that_is_torn() -> None:
    with fake_camera("-r", "2"):
        camera = open_camera(table(), MonotonicClock())
        try:
            camera.start(30.0)
            frames = list(itertools.islice(iter(lambda: camera.next_frame(5.0), None), 40))
        finally:
            camera.close()
    lost = frames[-1].number + 1 - len(frames)
    assert lost > 0
    assert camera.incomplete == pytest.approx(lost, abs=5)  # of those that came last, or before the first, one may be
    assert camera.links_lost == 0


def test_an_address_where_no_camera_answers_is_told_in_time() -> None:
    with fake_camera() as camera:
        camera.kill()
        begun = time.monotonic()
        with pytest.raises(DeviceError, match=ADDRESS):
            open_camera(table(), MonotonicClock())
        assert time.monotonic() - begun < 10.0


def test_closing_leaves_no_thread_and_the_library_is_silent(fake: FakeCamera) -> None:
    code = f"""
import threading
from pathlib import Path
from vialight.core.config import Camera, CameraSettings
from vialight.devices import MonotonicClock
from vialight.devices.cameras import open_camera
settings = CameraSettings(device="{ADDRESS}", pixel_format="Mono16", region=(0, 0, 480, 300))
table = Camera(pixel_mm=0.1, axis_column=1, optical_row=1, driver="aravis", settings=settings)
camera = open_camera(table, MonotonicClock())
camera.start(20.0)
camera.next_frame(5.0)
camera.close()
names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
assert not [name for name in names if name.startswith("arv")], names
assert threading.active_count() == 1
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False, timeout=60)
    assert (done.returncode, done.stdout) == (0, ""), done.stderr


def test_without_the_library_it_is_said_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "gi", None)
    with pytest.raises(
        DeviceError, match=r"aravis: is not installed .*apt-get install .*pip install 'vialight\[aravis\]'"
    ):
        open_camera(table(), MonotonicClock())
    assert threading.active_count() >= 1
