"""What a rig asks for, and what a camera makes of it."""

from __future__ import annotations

import pytest

from devices.cameras.pretend import standard_features
from vialight.core.config import CameraSettings
from vialight.devices import DeviceError
from vialight.devices.cameras.features import (
    Range,
    apply_settings,
    enable_chunks,
    most_counts,
    set_frame_rate,
    settings_in_force,
)


def test_what_the_rig_leaves_out_stays_but_counts_become_linear_and_steady() -> None:
    features = standard_features()
    assert apply_settings(features, CameraSettings()) == []
    assert (features.values["Width"], features.values["PixelFormat"]) == (640, "Mono12p")
    assert (features.values["GammaEnable"], features.values["ExposureAuto"]) == (False, "Off")
    assert features.values["TriggerMode"] == "Off"


def test_a_gamma_that_cannot_be_switched_off_is_told() -> None:
    features = standard_features(ExposureAuto="Off", GammaEnable=2)
    features.ranges["GammaEnable"] = Range(1, 2, 1)
    assert [str(one) for one in apply_settings(features, CameraSettings())] == ["GammaEnable is 2 instead of 0"]


def test_values_that_the_camera_rounds_are_told() -> None:
    features = standard_features()
    told = apply_settings(features, CameraSettings(region=(13, 20, 490, 300), exposure_s=2.0, gain_db=3.0))
    assert [str(one) for one in told] == [
        "Width is 480 instead of 490", "OffsetX is 8 instead of 13", "ExposureTime is 1e+06 instead of 2e+06",
    ]  # fmt: skip
    assert features.values["Gain"] == pytest.approx(3.0)


def test_offsets_make_room_before_the_size_is_set() -> None:
    features = standard_features(OffsetX=320)
    apply_settings(features, CameraSettings(region=(160, 50, 480, 300)))
    names = [name for name, _ in features.noted if name in ("OffsetX", "OffsetY", "Width", "Height")]
    assert names == ["OffsetX", "OffsetY", "Width", "Height", "OffsetX", "OffsetY"]
    assert [features.values[name] for name in ("OffsetX", "OffsetY", "Width", "Height")] == [160, 50, 480, 300]


def test_a_camera_that_cannot_bin_decimates_and_one_that_cannot_either_says_so() -> None:
    features = standard_features(DecimationHorizontal=1, DecimationVertical=1)
    del features.values["BinningHorizontal"], features.values["BinningVertical"]
    apply_settings(features, CameraSettings(binning=2))
    assert (features.values["DecimationHorizontal"], features.values["DecimationVertical"]) == (2, 2)
    del features.values["DecimationHorizontal"], features.values["DecimationVertical"]
    apply_settings(features, CameraSettings(binning=1))
    with pytest.raises(DeviceError, match="can neither bin nor decimate"):
        apply_settings(features, CameraSettings(binning=2))


@pytest.mark.parametrize(
    ("trigger", "mode", "source"),
    [("free-running", "Off", "Line1"), ("software", "On", "Software"), ("line", "On", "Line0")],
)
def test_each_trigger_sets_that_of_the_frame_alone(trigger: str, mode: str, source: str) -> None:
    features = standard_features()
    apply_settings(features, CameraSettings.model_validate({"trigger": trigger}))
    assert ("TriggerMode", "Off") in features.noted  # that of the acquisition, which was on
    assert (features.values["TriggerSelector"], features.values["TriggerMode"]) == ("FrameStart", mode)
    assert features.values["TriggerSource"] == source


def test_what_a_camera_does_not_take_is_told_with_what_it_takes() -> None:
    with pytest.raises(DeviceError, match="does not take Mono10 for PixelFormat; accepted: Mono8, Mono12p, Mono16"):
        apply_settings(standard_features(), CameraSettings(pixel_format="Mono10"))
    with pytest.raises(DeviceError, match="does not take Line7 for TriggerSource; accepted: Line0, Line1"):
        apply_settings(standard_features(), CameraSettings(trigger="line", trigger_line="Line7"))
    features = standard_features()
    del features.values["Gain"]
    with pytest.raises(DeviceError, match="has no feature Gain; leave it out"):
        apply_settings(features, CameraSettings(gain_db=1.0))


def test_a_rate_that_the_exposure_does_not_allow_is_refused_with_what_is_possible() -> None:
    assert set_frame_rate(standard_features(), 20.0) == 20.0
    with pytest.raises(DeviceError, match=r"at most 5 frames/s at an exposure of 200 ms; asked for 10; shorten"):
        set_frame_rate(standard_features(ExposureTime=200_000.0), 10.0)
    with pytest.raises(DeviceError, match=r"at most 100 frames/s at an exposure of 10 ms; asked for 150"):
        set_frame_rate(standard_features(), 150.0)


def test_saturation_is_where_the_camera_says_it_is() -> None:
    assert most_counts(standard_features(), 65535) == 65535
    assert most_counts(standard_features(PixelDynamicRangeMax=4095), 65535) == 4095


def test_chunks_that_a_camera_offers_are_switched_on() -> None:
    assert enable_chunks(standard_features()) == []
    features = standard_features(ChunkModeActive=False, ChunkSelector="Gain", ChunkEnable=False)
    features.entries["ChunkSelector"] = ["Gain", "Timestamp", "ExposureTime"]
    assert enable_chunks(features) == ["ChunkTimestamp", "ChunkExposureTime"]
    assert features.values["ChunkModeActive"] is True
    assert features.noted.count(("ChunkEnable", True)) == 2


def test_settings_in_force_bring_back_a_camera_that_has_forgotten_them() -> None:
    features = standard_features(OffsetX=80, Width=320, Gain=6.0, PixelFormat="Mono16")
    in_force = settings_in_force(features, CameraSettings(exposure_s=0.01))
    fresh = standard_features()
    assert apply_settings(fresh, in_force) == []
    for name in ("OffsetX", "OffsetY", "Width", "Height", "PixelFormat", "ExposureTime", "Gain", "BinningVertical"):
        assert fresh.values[name] == features.values[name]
