"""Files of faults: what is read, and what is refused in one line."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest

from vialight.core.config import Camera
from vialight.core.errors import InputError
from vialight.twin import Faults, find_rig, load_faults

WHOLE = """
axis_offset_mm = [0.1, -0.05]
run_out_mm = 0.02
tilt_deg = [0.5, 0]
speed_ripple = 0.01
ripples_a_turn = 5
led_drift_per_s = -1e-4
dropped_share = 0.05
timestamp_jitter_s = 0.001
specks = 20
speck_mm = 0.2
speck_counts_per_mm = 300.0
projector_shift_pixels = [3, -1.5]
projector_gain = 0.9

[believed.resin]
index_imaging = 1.485

[believed.camera]
distance_mm = 195.0
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "faults.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_whole_file_is_read(tmp_path: Path) -> None:
    wrong = load_faults(written(tmp_path, WHOLE))
    assert wrong.faults == Faults(
        axis_offset_mm=(0.1, -0.05), run_out_mm=0.02, tilt_rad=(float(np.radians(0.5)), 0.0), speed_ripple=0.01,
        ripples_a_turn=5, led_drift_per_s=-1e-4, dropped_share=0.05, timestamp_jitter_s=0.001, specks=20, speck_mm=0.2,
        speck_counts_per_mm=300.0, projector_shift_pixels=(3.0, -1.5), projector_gain=0.9,
    )  # fmt: skip
    keys = set(re.findall(r"^(\w+) =", WHOLE.split("[believed")[0], re.MULTILINE))
    assert keys == {field.name.replace("_rad", "_deg") for field in fields(Faults)}  # every fault can be asked for


def test_the_reconstruction_is_told_what_is_not_true(tmp_path: Path) -> None:
    rig = find_rig("orth2022-190")
    told = load_faults(written(tmp_path, WHOLE)).rig_as_believed(rig)
    assert told.camera == Camera(distance_mm=195.0, pixel_mm=0.155, axis_column=87.5, optical_row=59.5)
    assert told.resin.index_imaging == 1.485
    assert (told.vial, told.stage, told.projector) == (rig.vial, rig.stage, rig.projector)


def test_a_file_may_ask_for_nothing(tmp_path: Path) -> None:
    wrong, rig = load_faults(written(tmp_path, "")), find_rig("orth2022-190")
    assert wrong.faults == Faults()
    assert wrong.rig_as_believed(rig) == rig


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("run_out = 0.1", "unknown key run_out; accepted: axis_offset_mm, run_out_mm, tilt_deg"),
        ("tilt_rad = [0.1, 0.0]", "unknown key tilt_rad"),
        ("axis_offset_mm = 0.1", "axis_offset_mm is 0.1; accepted: 2 finite numbers in brackets"),
        ("axis_offset_mm = [0.1]", "axis_offset_mm is [0.1]"),
        ("axis_offset_mm = [nan, 0.0]", "axis_offset_mm is [nan, 0.0]"),
        ("specks = 2.5", "specks is 2.5; accepted: a whole number"),
        ("run_out_mm = true", "run_out_mm is True; accepted: a finite number"),
        ("dropped_share = 1.5", "dropped_share is 1.5; accepted: 0 to 0.95"),
        ("ripples_a_turn = 0", "ripples_a_turn is 0"),
        ("speed_ripple = -0.1", "speed_ripple is -0.1"),
        ("believed = 3", "believed is 3; accepted: tables of a rig"),
        ("run_out_mm 0.1", "is not TOML"),
    ],
)
def test_a_faulty_file_of_faults_is_told_by_its_fault(tmp_path: Path, text: str, fault: str) -> None:
    path = written(tmp_path, text)
    with pytest.raises(InputError) as told:
        load_faults(path)
    assert str(told.value).startswith(str(path))
    assert fault in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("[believed.camera]\nfocus_mm = 1.0", "[believed] [camera]: unknown key focus_mm"),
        ("[believed.lens]\nfocus_mm = 1.0", "[believed]: unknown key lens"),
        ("[believed.resin]\nindex_imaging = 0.5", "[believed] [resin]: index_imaging is 0.5"),
        ("[believed]\ncamera = 7", "[believed]: camera is 7"),
    ],
)
def test_a_rig_that_cannot_be_believed_is_told(tmp_path: Path, text: str, fault: str) -> None:
    wrong = load_faults(written(tmp_path, text))
    with pytest.raises(InputError, match=re.escape(f"faults.toml {fault}")):
        wrong.rig_as_believed(find_rig("orth2022-190"))


def test_a_file_that_is_not_there_is_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: cannot be read"):
        load_faults(tmp_path / "none.toml")
