"""The projector is found from what the twin's camera, which knows no formula of the vial, sees of its lines."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vialight.calibration.projector.command import SweepOptions
from vialight.calibration.projector.estimator import Sweep, fit_projector
from vialight.commands.calibrate import calibrate_projector
from vialight.core.errors import InputError
from vialight.store.rig_files import load_rig
from vialight.twin import find_rig, load_resin

RIG = Path(__file__).parents[2] / "src/vialight/twin/presets/rigs/orth2022-190.toml"


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sweep of a projector 4 columns off, whose rig has it on the wrong side, with another pixel."""
    folder: Path = tmp_path_factory.mktemp("sweep")
    (folder / "faults.toml").write_text(
        "projector_shift_pixels = [4.0, 0.0]\n[believed.projector]\nazimuth_deg = 88.0\npixel_mm = 0.0645\n"
    )
    calibrate_projector(RIG, folder / "new.toml", options=SweepOptions(faults=folder / "faults.toml"))
    return folder


def test_axis_pixel_and_azimuth_are_found_within_their_uncertainties(swept: Path) -> None:
    rig = load_rig(swept / "new.toml")
    projector, known = rig.need_projector(), rig.uncertainty
    assert known is not None
    assert known.projector is not None
    assert known.resin is not None
    # An image that is shown 4 columns further right meets the axis with what it has 4 columns further left.
    for found, true, std, fine in (
        (projector.axis_column, 507.5, known.projector["axis_column"], 1.5),
        (projector.pixel_mm, 0.065, known.projector["pixel_mm"], 1.5e-4),
        (projector.azimuth_deg, -90.0, known.projector["azimuth_deg"], 0.5),
    ):
        assert abs(found - true) < 3 * std
        assert std < fine
    assert rig.resin.absorption_per_mm == pytest.approx(0.08, rel=0.01)


def test_the_wrong_side_is_told(swept: Path) -> None:
    page = (swept / "new.html").read_text()
    assert "are mirrored" in page


def test_a_recorded_sweep_gives_what_it_gave(swept: Path, tmp_path: Path) -> None:
    """To a third of the uncertainties: from where the fit starts decides which rays at the rim are compared."""
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.read_text() + "[resin]\nindex_imaging = 1.48\nindex_writing = 1.49\n")
    result = calibrate_projector(rig, tmp_path / "again.toml", options=SweepOptions(swept / "new.sweep.h5"))
    first = load_rig(swept / "new.toml").need_projector()
    found = {value["key"]: value["value"] for value in result["found"]}
    assert found["azimuth_deg"] == pytest.approx(first.azimuth_deg, abs=0.1)
    assert found["axis_column"] == pytest.approx(first.axis_column, abs=0.3)


def test_lines_that_do_not_glow_are_refused() -> None:
    rig = load_resin("DUDMA").in_vial_of(find_rig("orth2022-190"))
    noise = np.random.default_rng(0).normal(0, 3, (20, 176))
    seen, lit = rig.imaging_optics(), rig.writing_optics()
    assert seen is not None
    assert lit is not None
    with pytest.raises(InputError, match="0 of 20 lines glow"):
        fit_projector(
            Sweep(noise, np.linspace(350, 650, 20), 24), rig.need_camera(), seen, rig.need_projector(), lit, 0.08
        )


def test_frames_of_a_print_are_no_sweep(tmp_path: Path) -> None:
    sample = RIG.parents[3] / "commands" / "sample"
    rig = tmp_path / "rig.toml"
    rig.write_text(RIG.read_text() + "[resin]\nindex_imaging = 1.48\nindex_writing = 1.49\n")
    with pytest.raises(InputError, match="is no sweep"):
        calibrate_projector(rig, tmp_path / "new.toml", options=SweepOptions(sample / "frames.h5"))
