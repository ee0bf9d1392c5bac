"""GenTL: the demonstration producer of the genicam wheel, a game that is played on three cameras."""

from __future__ import annotations

import contextlib
import signal
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from needs import need_module
from vialight.core.config import Camera, CameraSettings
from vialight.core.errors import InputError, VialightWarning
from vialight.devices import DeviceError, DeviceTimeoutError, MonotonicClock
from vialight.devices.cameras import list_cameras, open_camera

pytestmark = pytest.mark.alone


@pytest.fixture(scope="module")
def producer() -> Path:
    need_module("harvesters")
    import genicam

    return Path(genicam.__file__).parent / "viky.cti"


def table(producer: Path, **settings: Any) -> Camera:
    wanted = {"device": "1", "producer": str(producer), "pixel_format": "Mono8", "region": (0, 0, 480, 300)} | settings
    return Camera(
        pixel_mm=0.1, axis_column=239.5, optical_row=149.5, driver="harvesters",
        settings=CameraSettings.model_validate(wanted),
    )  # fmt: skip


def test_the_demo_producer_streams_without_loss_at_an_even_pace(producer: Path) -> None:
    interrupt = signal.getsignal(signal.SIGINT)
    camera = open_camera(table(producer), MonotonicClock())
    try:
        assert (camera.image_shape, camera.full_level, camera.rounded) == ((300, 480), 255, [])
        camera.start(30.0)
        frames = [camera.next_frame(5.0) for _ in range(90)]
        camera.start(10.0)
        again = [camera.next_frame(5.0) for _ in range(3)]
    finally:
        camera.close()
    assert signal.getsignal(signal.SIGINT) is interrupt
    assert [frame.number for frame in frames] == list(range(90))
    assert [frame.number for frame in again] == [0, 1, 2]
    assert (camera.incomplete, camera.links_lost) == (0, 0)
    assert frames[0].counts.shape == (300, 480)
    assert 0 < frames[0].counts.max() <= 255
    assert not np.array_equal(frames[0].counts, frames[-1].counts)  # the ball has moved
    assert (frames[-1].time_s - frames[0].time_s) / 89 == pytest.approx(1 / 30, rel=0.02)


def test_a_camera_that_falls_silent_is_opened_anew_with_its_settings_and_goes_on(producer: Path) -> None:
    """The producer has no cable to pull: it is told to stop, behind the driver's back."""
    camera = open_camera(table(producer, region=(0, 0, 320, 200)), MonotonicClock())
    try:
        camera.start(30.0)
        before = [camera.next_frame(5.0) for _ in range(10)]
        assert camera._link is not None
        camera._link.features.execute("AcquisitionStop")
        with contextlib.suppress(DeviceTimeoutError):  # what had come already
            while True:
                before.append(camera.next_frame(0.5))
        after = [camera.next_frame(10.0) for _ in range(10)]
    finally:
        camera.close()
    assert camera.links_lost == 1
    assert {frame.counts.shape for frame in (*before, *after)} == {(200, 320)}
    gone_s = after[0].time_s - before[-1].time_s
    assert gone_s > 1.0
    assert after[0].number - before[-1].number == pytest.approx(30.0 * gone_s, abs=3)
    assert [frame.number for frame in after] == list(range(after[0].number, after[0].number + 10))


def test_settings_are_read_back(producer: Path) -> None:
    with pytest.warns(VialightWarning, match="Width is 800 instead of 1000"):
        camera = open_camera(table(producer, region=(0, 0, 1000, 300)), MonotonicClock())
    assert camera.image_shape == (300, 800)
    camera.close()
    with pytest.raises(DeviceError, match="does not take Mono16 for PixelFormat; accepted: RGBa8, Mono8"):
        open_camera(table(producer, pixel_format="Mono16"), MonotonicClock())
    with pytest.raises(DeviceError, match=r"RGBa8; set \[camera.settings\] pixel_format"):
        open_camera(table(producer, pixel_format=None), MonotonicClock())


def test_which_camera_is_meant_must_be_told(producer: Path) -> None:
    with pytest.raises(DeviceError, match=r"3 were found; found: Machine Vision Games Ltd. Viky, serial number 0; .*"):
        open_camera(table(producer, device=None), MonotonicClock())
    with pytest.raises(DeviceError, match="camera 7: was not found; found: Machine"):
        open_camera(table(producer, device="7"), MonotonicClock())


def test_cameras_of_the_producers_on_the_standard_path_are_listed(
    producer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("GENICAM_GENTL64_PATH", str(producer.parent))
    found, _ = list_cameras()
    assert [one.serial for one in found if one.driver == "harvesters"] == ["0", "1", "2"]
    monkeypatch.delenv("GENICAM_GENTL64_PATH")
    found, unable = list_cameras()
    assert [one for one in found if one.driver == "harvesters"] == []
    assert "GENICAM_GENTL64_PATH names no folder" in unable["harvesters"]


def test_a_producer_that_is_missing_or_a_library_that_is_not_there_is_told(
    producer: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match=r"nowhere.cti is not there; accepted: a GenTL producer"):
        open_camera(table(Path("nowhere.cti")), MonotonicClock())
    monkeypatch.setitem(sys.modules, "harvesters.core", None)
    with pytest.raises(DeviceError, match=r"is not installed .*pip install 'vialight\[harvesters\]'"):
        open_camera(table(producer), MonotonicClock())
