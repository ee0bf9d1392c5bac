"""Resins and rigs that come with the package can be used as they are, and others are refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from vialight.core.errors import InputError
from vialight.twin.camera import image_shape
from vialight.twin.presets import find_rig, load_resin, resin_names, rig_names


@pytest.mark.parametrize("resin", resin_names())
@pytest.mark.parametrize("rig", rig_names())
def test_every_resin_fits_every_rig(resin: str, rig: str) -> None:
    model = load_resin(resin)
    filled = model.in_vial_of(find_rig(rig))
    imaging, writing = filled.imaging_optics(), filled.writing_optics()
    assert imaging is not None
    assert writing is not None
    assert imaging.resin_index == model.optical.index_imaging
    assert writing.resin_index == model.optical.index_writing
    assert filled.need_projector().irradiance_mw_per_cm2
    rows, columns = image_shape(filled.need_camera())
    pixel = filled.need_camera().pixel_mm
    assert columns * pixel > 2.1 * imaging.outer_radius_mm  # the vial's edges are in the image
    assert rows * pixel > 15
    assert model.scattering.middle_conversion != model.chemistry.gel_conversion


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        ("colour = 1", "colour"),
        ("[resin]\nindex_imaging = 0.5", "index_imaging"),
        ("[resin]\nindex_imaging = 1.5\nindex_writing = 1.5", "absorption_per_mm"),
        ("[chemistry]\nquantum_yeld = 0.5", "quantum_yeld"),
        ('[chemistry]\nquantum_yield = "much"', "much"),
        ("[chemistry]\nquantum_yield = -1.0", "quantum_yield"),
        ("chemistry = 3", "chemistry"),
        ("[[", "TOML"),
    ],
)
def test_a_resin_with_a_fault_is_told_by_it(tmp_path: Path, text: str, fault: str) -> None:
    path = tmp_path / "resin.toml"
    optics = "" if "resin" in text else "[resin]\nindex_imaging = 1.5\nindex_writing = 1.5\nabsorption_per_mm = 0.1\n"
    path.write_text(f"{text}\n{optics}" if not text.startswith("[") else f"{optics}{text}")
    with pytest.raises(InputError, match=fault):
        load_resin(path)


def test_a_resin_that_is_not_there_is_told_with_those_that_are() -> None:
    with pytest.raises(InputError, match="BPAGDA, DUDMA"):
        load_resin("PEGDA")


def test_a_rig_may_be_a_file(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").write_text("[vial]\nouter_radius_mm = 9.0\n")
    vial = find_rig(tmp_path / "mine.toml").vial
    assert vial is not None
    assert vial.outer_radius_mm == 9.0
    with pytest.raises(InputError, match=r"none\.toml"):
        find_rig(tmp_path / "none.toml")
