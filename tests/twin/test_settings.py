"""Files that say how closely the twin looks."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest

from vialight.core.errors import InputError
from vialight.twin import Faults, TwinSettings, load_settings

WHOLE = """
chemistry_step_s = 0.5
blur_mm = 0.03
points_a_voxel = [3, 2, 1]
rays_a_side = 2
exposure_s = 0.05
poses_a_frame = 5
pupil_radius_mm = 1.5
pupil_points = 7
focus_mm = 2.0
projector_pupil_radius_mm = 3.0
projector_pupil_points = 4
extinction_mm2 = 1e-4
index_rise = 0.02
[stray]
base_counts = 10.0
edge_counts = 0.0
edge_width_mm = 0.5
[sensor]
read_noise_counts = 2.0
electrons_per_count = 8.0
bits = 10
"""


def written(folder: Path, text: str) -> Path:
    path = folder / "twin.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_whole_file_is_read_and_the_rest_stays_as_given(tmp_path: Path) -> None:
    given = TwinSettings(binning=4, seed=7, faults=Faults(run_out_mm=0.1))
    read = load_settings(written(tmp_path, WHOLE), given)
    assert read.points_a_voxel == (3, 2, 1)
    assert (read.pupil_points, read.index_rise, read.extinction_mm2) == (7, 0.02, 1e-4)
    assert (read.stray.edge_counts, read.sensor.bits, read.sensor.electrons_per_count) == (0.0, 10, 8.0)
    assert (read.binning, read.seed, read.faults) == (4, 7, given.faults)
    asked = set(re.findall(r"^(\w+) =", WHOLE.split("[stray]")[0], re.MULTILINE))
    elsewhere = {"binning", "image_shape", "stray", "sensor", "faults", "seed"}
    assert asked == {field.name for field in fields(TwinSettings)} - elsewhere  # all can be asked for


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("aperture = 8", "unknown key aperture; accepted: chemistry_step_s"),
        ("binning = 2", "unknown key binning"),
        ("points_a_voxel = [1, 1]", "points_a_voxel is [1, 1]; accepted: 3 whole numbers in brackets"),
        ("points_a_voxel = [1, 1, 1.5]", "points_a_voxel is [1, 1, 1.5]"),
        ("exposure_s = 0", "exposure_s is 0.0; accepted: 1e-05 to 10"),
        ("pupil_points = 0", "pupil_points is 0"),
        ("index_rise = nan", "index_rise is nan"),
        ("[sensor]\nbits = 12.5", "[sensor]: bits is 12.5; accepted: a whole number"),
        ("sensor = 3", "[sensor]: is 3; accepted: a table of read_noise_counts"),
    ],
)
def test_a_faulty_file_is_told_by_its_fault(tmp_path: Path, text: str, fault: str) -> None:
    with pytest.raises(InputError) as told:
        load_settings(written(tmp_path, text))
    assert fault in str(told.value)
    assert str(told.value).startswith(str(tmp_path / "twin.toml"))
