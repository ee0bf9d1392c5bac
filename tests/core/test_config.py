"""Rig files: what is read, and what is refused in one line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.core.config import Camera, Optics, Rig
from vialight.core.errors import InputError
from vialight.store.rig_files import load_rig

WHOLE_RIG = """
schema = 1
[vial]
outer_radius_mm = 12.4
wall_mm = 1.1
wall_index = 1.472
[resin]
name = "DUDMA"
index_imaging = 1.48
index_writing = 1.49
absorption_per_mm = 0.08
threshold = 100.0
threshold_conditions = { exposure_s = 0.05, gain_db = 0.0, led_level = 0.7, binning = 4 }
[camera]
distance_mm = 190.0
pixel_mm = 0.155
axis_column = 87.9
optical_row = 59.5
[projector]
distance_mm = 119.8
pixel_mm = 0.065
columns = 1024
rows = 768
axis_column = 511.5
azimuth_deg = -90.0
[stage]
speed_deg_s = 20.0
direction = -1
"""


def write_rig(folder: Path, text: str) -> Path:
    path = folder / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return path


def refusal(folder: Path, text: str) -> str:
    path = write_rig(folder, text)
    with pytest.raises(InputError) as caught:
        load_rig(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


def test_a_whole_rig_is_read(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path, WHOLE_RIG))
    assert rig.imaging_optics() == Optics(12.4, 12.4 - 1.1, 1.472, 1.48, 190.0)
    assert rig.writing_optics() == Optics(12.4, 12.4 - 1.1, 1.472, 1.49, 119.8)
    assert rig.need_camera().pixel_mm == 0.155
    assert rig.stage.direction == -1
    assert rig.resin.threshold_conditions is not None
    assert rig.resin.threshold_conditions.binning == 4


def test_what_a_command_does_not_need_may_be_absent(tmp_path: Path) -> None:
    rig = load_rig(
        write_rig(tmp_path, 'geometry = "parallel"\n[camera]\npixel_mm = 1.0\naxis_column = 10\noptical_row = 0.5\n')
    )
    assert rig.imaging_optics() is None
    assert rig.writing_optics() is None
    assert rig.stage.direction == 1


def test_no_wall_means_no_glass(tmp_path: Path) -> None:
    optics = load_rig(write_rig(tmp_path, WHOLE_RIG.replace("wall_mm = 1.1", "wall_mm = 0"))).imaging_optics()
    assert optics is not None
    assert optics.inner_radius_mm == optics.outer_radius_mm
    assert optics.field_radius_mm == 12.4 / 1.48


def test_a_telecentric_camera_is_infinitely_far(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path, WHOLE_RIG.replace("distance_mm = 190.0", "distance_mm = inf")))
    optics = rig.imaging_optics()
    assert optics is not None
    assert optics.distance_mm == np.inf


def test_the_field_ends_where_glass_or_refraction_ends_it() -> None:
    assert Optics(12.4, 11.3, 1.472, 1.48, 190.0).field_radius_mm == 12.4 / 1.48
    assert Optics(12.4, 6.0, 1.472, 1.48, 190.0).field_radius_mm == 6.0


@pytest.mark.parametrize(("text", "sense"), [("1", 1), ("-1", -1), ('"clockwise"', -1), ('"counter-clockwise"', 1)])
def test_the_stage_turns_either_way_by_number_or_by_word(tmp_path: Path, text: str, sense: int) -> None:
    rig = load_rig(write_rig(tmp_path, WHOLE_RIG.replace("direction = -1", f"direction = {text}")))
    assert rig.stage.direction == sense


@pytest.mark.parametrize(
    ("old", "new", "parts"),
    [
        ("wall_mm", "wall", ["[vial]", "unknown key wall", "wall_mm", "wall_index"]),
        ("[stage]", "[turntable]", ["unknown key turntable", "stage"]),
        ("outer_radius_mm = 12.4", "", ["[vial]", "outer_radius_mm is missing"]),
        ("outer_radius_mm = 12.4", "outer_radius_mm = -12.4", ["[vial]", "outer_radius_mm is -12.4", "greater than 0"]),
        ("outer_radius_mm = 12.4", "outer_radius_mm = inf", ["outer_radius_mm is inf", "finite"]),
        ("outer_radius_mm = 12.4", 'outer_radius_mm = "wide"', ["outer_radius_mm is 'wide'", "number"]),
        ("wall_mm = 1.1", "wall_mm = 12.4", ["wall_mm 12.4", "less than outer_radius_mm"]),
        ("index_imaging = 1.48", "index_imaging = 0.9", ["[resin]", "index_imaging is 0.9", "1"]),
        ("distance_mm = 190.0", "distance_mm = nan", ["[camera]", "distance_mm is nan"]),
        ("pixel_mm = 0.155", "pixel_mm = 0", ["[camera]", "pixel_mm is 0", "greater than 0"]),
        ("axis_column = 87.9", "axis_column = nan", ["axis_column is nan", "finite"]),
        ("direction = -1", "direction = 2", ["[stage]", "direction is 2", "1 or -1"]),
        ("direction = -1", "direction = [1]", ["[stage]", "direction is [1]", "1 or -1"]),
        ("schema = 1", "schema = 2", ["schema is 2", "1"]),
        ("exposure_s = 0.05", "exposure_s = -1", ["[resin.threshold_conditions]", "exposure_s is -1"]),
        ("exposure_s = 0.05", "shutter = 1", ["[resin.threshold_conditions]", "unknown key shutter", "exposure_s"]),
        ("schema = 1", 'geometry = "fan"', ["geometry is 'fan'", "'vial' or 'parallel'"]),
        ("schema = 1", 'source = "elsewhere"', ["unknown key source"]),
        ("gain_db = 0.0", "gain_db = true", ["gain_db is True", "number"]),
        ("pixel_mm = 0.155", 'pixel_mm = "0.155"', ["pixel_mm is '0.155'", "number"]),
        ("[vial]", "[vial", ["is not TOML"]),
    ],
)
def test_what_is_wrong_is_named_with_its_value_and_what_is_accepted(
    tmp_path: Path, old: str, new: str, parts: list[str]
) -> None:
    message = refusal(tmp_path, WHOLE_RIG.replace(old, new, 1))
    for part in parts:
        assert part in message


@pytest.mark.parametrize("text", ["vial = 3", "[[vial]]\nwall_mm = 1.1"])
def test_what_should_be_a_table_is_told_its_keys(tmp_path: Path, text: str) -> None:
    assert "accepted: a table of outer_radius_mm, wall_mm, wall_index" in refusal(tmp_path, text)


@pytest.mark.parametrize(
    ("without", "parts"),
    [
        ("index_imaging = 1.48\n", ["[resin] has no index_imaging"]),
        ("distance_mm = 190.0\n", ["[camera] has no distance_mm", "inf for telecentric"]),
    ],
)
def test_imaging_through_a_vial_asks_for_what_it_needs(tmp_path: Path, without: str, parts: list[str]) -> None:
    rig = load_rig(write_rig(tmp_path, WHOLE_RIG.replace(without, "")))
    with pytest.raises(InputError) as caught:
        rig.imaging_optics()
    for part in [*parts, str(tmp_path)]:
        assert part in str(caught.value)


def test_missing_tables_are_asked_for_by_name() -> None:
    with pytest.raises(InputError, match=r"no table \[camera\]"):
        Rig().need_camera()
    with pytest.raises(InputError, match=r"no table \[projector\]"):
        Rig().writing_optics()
    camera = Camera(distance_mm=190, pixel_mm=0.155, axis_column=87.9, optical_row=59.5)
    with pytest.raises(InputError, match=r'no table \[vial\].*geometry = "parallel"'):
        Rig(camera=camera).imaging_optics()


def test_a_pupil_inside_the_vial_is_refused(tmp_path: Path) -> None:
    rig = load_rig(write_rig(tmp_path, WHOLE_RIG.replace("distance_mm = 190.0", "distance_mm = 12.4")))
    with pytest.raises(InputError, match=r"\[camera\].*puts the pupil inside the vial"):
        rig.imaging_optics()


def test_a_missing_file_is_said_to_be_missing(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file"):
        load_rig(tmp_path / "nothing.toml")


def test_a_file_that_is_not_text_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "rig.toml"
    path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="is not TOML"):
        load_rig(path)


@given(st.integers(1, 8), st.integers(0, 500))
def test_a_binned_pixel_lies_at_the_middle_of_those_it_sums(binning: int, index: int) -> None:
    camera = Camera(pixel_mm=0.1, axis_column=100.3, optical_row=50.2)
    binned = camera.binned(binning)
    first = index * binning
    middle = np.mean([(column - camera.axis_column) * camera.pixel_mm for column in range(first, first + binning)])
    assert (index - binned.axis_column) * binned.pixel_mm == pytest.approx(middle, abs=1e-9)
    middle = np.mean([(camera.optical_row - row) * camera.pixel_mm for row in range(first, first + binning)])
    assert (binned.optical_row - index) * binned.pixel_mm == pytest.approx(middle, abs=1e-9)


def test_instruments_and_calibrations_are_read(tmp_path: Path) -> None:
    text = WHOLE_RIG.replace("[projector]", 'driver = "aravis"\n[camera.settings]\nexposure_s = 0.05\n[projector]')
    text += "run_out = { radius_mm = 0.02, phase_deg = 30.0 }\n[uncertainty.camera]\naxis_column = 0.01\n"
    text += '[calibration.axis]\ndate = "2026-11-25"\n'
    rig = load_rig(write_rig(tmp_path, text))
    assert rig.camera is not None
    assert rig.camera.settings is not None
    assert rig.camera.settings.exposure_s == 0.05
    assert rig.stage.run_out is not None
    assert rig.stage.run_out.radius_mm == 0.02
    assert rig.uncertainty is not None
    assert rig.uncertainty.camera == {"axis_column": 0.01}
    assert rig.calibration is not None
    assert rig.calibration["axis"].date == "2026-11-25"


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[camera.settings]\nshutter = 3", ("[camera.settings]", "unknown key shutter", "exposure_s")),
        ('[camera.settings]\npixel_format = "RGB8"', ("pixel_format", "Mono12")),
        ("[camera.settings]\nregion = [1, 2]", ("region",)),
        ("[camera.settings]\nbinning = 0", ("binning", "greater than or equal to 1")),
        ('driver = "webcam"', ("driver", "aravis")),
        ("[calibration.axis]\nfile = 3", ("[calibration.axis]", "date")),
        ("[uncertainty.camera]\naxis = 0.1", ("uncertainty", "camera has no key axis")),
        ("[uncertainty.camera]\naxis_column = -0.1", ("axis_column", "greater than or equal to 0")),
    ],
)
def test_faults_in_inner_tables_name_the_table(tmp_path: Path, text: str, told: tuple[str, ...]) -> None:
    message = refusal(tmp_path, WHOLE_RIG.replace("[projector]", f"{text}\n[projector]"))
    assert all(part in message for part in told), message
