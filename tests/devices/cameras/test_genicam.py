"""What all GenICam cameras do, with a camera that sends what a test puts."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import pytest

from devices.cameras.pretend import HandClock, PretendLink, standard_features
from vialight.core.config import CameraSettings
from vialight.core.errors import VialightWarning
from vialight.devices import CameraFrame, DeviceError, DeviceTimeoutError, MonotonicClock
from vialight.devices.cameras import GenicamCamera

EIGHT_BITS = CameraSettings(pixel_format="Mono8", region=(0, 0, 64, 20))


@contextmanager
def grabbing(
    link: PretendLink, settings: CameraSettings = EIGHT_BITS, rate_hz: float = 10.0
) -> Iterator[GenicamCamera]:
    camera = GenicamCamera(lambda: link, settings, MonotonicClock())
    try:
        camera.start(rate_hz)
        yield camera
    finally:
        camera.close()


def wait_for(what: Callable[[], bool]) -> None:
    deadline = time.monotonic() + 10.0
    while not what():
        assert time.monotonic() < deadline
        time.sleep(0.005)


def test_frames_come_in_order_with_numbers_that_tell_what_was_lost() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        assert camera.image_shape == (20, 64)
        assert camera.full_level == 255
        for frame_id in (65534, 65535, 2):
            link.put(frame_id)
        frames = [camera.next_frame(2.0) for _ in range(3)]
    assert [frame.number for frame in frames] == [0, 1, 3]
    assert [int(frame.counts.max()) for frame in frames] == [254, 255, 2]
    assert frames[0].counts.shape == (20, 64)


def test_a_frame_of_which_a_part_was_lost_is_counted_and_never_shown() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        link.put(5)
        link.put(0, is_complete=False)
        link.put(7)
        assert [camera.next_frame(2.0).number for _ in range(2)] == [0, 2]
        with pytest.raises(DeviceTimeoutError, match="no frame within"):
            camera.next_frame(0.01)
        assert camera.incomplete == 1


def test_time_is_the_cameras_own_less_the_latency() -> None:
    link, clock = PretendLink(), HandClock()
    camera = GenicamCamera(lambda: link, EIGHT_BITS.model_copy(update={"latency_s": 0.03}), clock)
    camera.start(10.0)
    try:
        frames: list[CameraFrame] = []
        for k, delay_s in enumerate((0.01, 0.04, 0.01, 0.09)):
            clock.time_s = 200.0 + 0.1 * k + delay_s
            link.put(k + 1, stamp_s=1.7e9 + 0.1 * k)
            frames.append(camera.next_frame(2.0))
    finally:
        camera.close()
    assert [frame.time_s for frame in frames] == pytest.approx([199.98, 200.08, 200.18, 200.28], abs=1e-4)


def test_the_exposure_is_that_which_a_frame_tells() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        assert camera.exposure_s == pytest.approx(0.01)
        link.put(1, exposure_s=0.0101)
        camera.next_frame(2.0)
        assert camera.exposure_s == pytest.approx(0.0101)


def test_two_seconds_of_frames_wait_and_older_ones_are_counted_as_lost() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        for frame_id in range(1, 41):
            link.put(frame_id)
        wait_for(lambda: link.frames.empty() and camera.overrun == 10)
        assert camera.next_frame(0.1).number == 10


def test_a_camera_that_comes_back_as_new_gets_its_settings_and_goes_on() -> None:
    links = [PretendLink(), PretendLink()]
    opened: list[PretendLink] = []

    def open_link() -> PretendLink:
        if len(opened) == 2:
            raise DeviceError("camera", "none was found")
        opened.append(links[len(opened)])
        return opened[-1]

    camera = GenicamCamera(open_link, EIGHT_BITS, MonotonicClock())
    camera.start(20.0)
    try:
        links[0].put(900)
        assert camera.next_frame(2.0).number == 0
        links[0].lost = True
        wait_for(lambda: links[1].started == 1)
        assert links[1].features.values["Width"] == 64
        links[1].put(1)
        after = camera.next_frame(2.0)
        assert after.number >= 1
        assert camera.links_lost == 1
        assert links[0].closed == 1
        links[1].features.fault = "is gone"
        links[1].lost = True
        wait_for(lambda: camera.links_lost == 2)
        with pytest.raises(DeviceTimeoutError, match=r"the link is lost .*looking for the camera"):
            camera.next_frame(0.1)
    finally:
        camera.close()
    assert links[1].closed == 1


def test_silence_is_taken_for_a_lost_link_where_the_camera_runs_freely() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        wait_for(lambda: camera.links_lost == 1)
    waiting = PretendLink()
    with grabbing(waiting, EIGHT_BITS.model_copy(update={"trigger": "line"})) as camera:
        time.sleep(2.2)
        assert camera.links_lost == 0
        waiting.features.fault = "does not answer"
        wait_for(lambda: camera.links_lost == 1)


def test_the_driver_fires_where_it_triggers() -> None:
    link = PretendLink()
    with grabbing(link, EIGHT_BITS.model_copy(update={"trigger": "software"}), 50.0):
        begun = time.monotonic()
        wait_for(lambda: link.features.noted.count(("TriggerSoftware", True)) == 20)
    assert time.monotonic() - begun > 0.35


def test_starting_again_begins_numbers_anew() -> None:
    link = PretendLink()
    with grabbing(link) as camera:
        link.put(44)
        camera.next_frame(2.0)
        camera.start(5.0)
        link.put(80)
        assert camera.next_frame(2.0).number == 0


def test_a_camera_is_closed_from_any_state() -> None:
    link = PretendLink()
    camera = GenicamCamera(lambda: link, EIGHT_BITS, MonotonicClock())
    with pytest.raises(DeviceTimeoutError, match="is not grabbing"):
        camera.next_frame(0.01)
    with pytest.raises(DeviceError, match="frames/s"):
        camera.start(float("nan"))
    camera.close()
    camera.close()
    assert link.closed == 1
    refused = PretendLink(standard_features(PixelFormat="BayerRG8"))
    with pytest.raises(DeviceError, match="sends BayerRG8"):
        GenicamCamera(lambda: refused, CameraSettings(), MonotonicClock())
    assert refused.closed == 1


def test_settings_that_are_rounded_are_told_as_a_warning() -> None:
    link = PretendLink()
    with pytest.warns(VialightWarning, match="Pretend P1 17: Width is 48 instead of 50"):
        camera = GenicamCamera(lambda: link, CameraSettings(region=(0, 0, 50, 20), pixel_format="Mono8"), HandClock())
    assert [one.feature for one in camera.rounded] == ["Width"]
    camera.close()
