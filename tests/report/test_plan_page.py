"""The plan's page: what it says, what it shows, and that it needs nothing but itself."""

from __future__ import annotations

import base64
import io
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from PIL import Image

from vialight import __version__
from vialight.core.arrays import Float32Array, Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.report import plan_page, write_plan_page
from vialight.report.plan_figures import Dosed, angle_words, cuts_through, filmstrip_indices, swept_outline

GRID = Grid((12, 16, 16), 0.5)
SHA = "ab" * 32
RIG: dict[str, Any] = {
    "vial": {"outer_radius_mm": 12.4, "wall_mm": 1.1, "wall_index": 1.472},
    "resin": {"name": "DUDMA", "index_writing": 1.49, "critical_exposure_mj_per_cm2": 60.0},
    "projector": {
        "distance_mm": 119.8, "pixel_mm": 0.25, "columns": 200, "rows": 120, "axis_column": 99.5, "azimuth_deg": -90.0,
        "irradiance_mw_per_cm2": 5.0,
    },
}  # fmt: skip
METRICS = {
    "voxel_error_rate": 0.000012, "process_window": -0.1234, "in_part_dose_range": 0.3456, "jaccard": 0.98765,
    "best_threshold": 0.8, "in_part_mean": 1.0, "in_part_std": 0.05, "void_max": 0.9, "light_efficiency": 0.0168,
    "exposure_per_turn_mj_per_cm2": 3.6724, "turns_to_critical_exposure": 16.338, "passes": 5,
    "believed": {"jaccard": 1.0, "light_efficiency": None}, "optimisation_s": 1.5,
}  # fmt: skip
SETTINGS = {
    "method": "object-space", "passes": None, "voxel_mm": 0.5, "coverage": False, "void_limit": 0.85,
    "rotate_deg": (0.0, 90.0, -5.0), "placement": np.diag([2.0, 2.0, 2.0, 1.0]).tolist(), "placed_scale": 2.0,
}  # fmt: skip


def half_filled() -> Float32Array:
    """A block that is off the axis, thicker below than above."""
    target = np.zeros(GRID.shape, np.float32)
    target[2:5, 6:10, 4:13] = 1
    target[5:10, 7:9, 9:12] = 1
    return target


def dose_for(target: Float32Array) -> Float32Array:
    dose = np.where(target > 0, 1.0, 0.3).astype(np.float32)
    dose[3, 6, 4] = 0.5  # does not cure
    dose[3, 5, 5] = dose[3, 5, 6] = 0.9  # cures, and should not
    return dose


def a_plan(**rig: Any) -> Plan:
    patterns = Patterns(
        np.random.default_rng(0).integers(0, 256, (12, 30, 44), np.uint8), np.arange(12) * np.pi / 6, 45, 78, 0.0135
    )
    box = trimesh.creation.box((4, 2, 4))
    return Plan(
        patterns, Mesh(np.asarray(box.vertices), np.asarray(box.faces)), half_filled(), GRID,
        Rig.model_validate(RIG | rig), SETTINGS, METRICS,
        {"part": {"file": "<b>odd</b> & part.stl", "sha256": SHA}, "rig": {"file": "rig.toml", "sha256": "cd" * 32}},
    )  # fmt: skip


def plain(text: str) -> str:
    """Single spaces, and signs as a keyboard has them."""
    signs = str.maketrans("\N{MINUS SIGN}\N{EN DASH}\N{MULTIPLICATION SIGN}", "--x")
    return " ".join(text.translate(signs).split())


class _Reader(HTMLParser):
    """Gathers what stands in a page: text, images, tags and all that would reach outside."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text = ""
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.feed(page)
        self.text = plain(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data: str) -> None:
        self.text += f" {data}"


def written(plan: Plan, folder: Path) -> str:
    write_plan_page(folder / "plan.html", plan, dose_for(plan.target))
    return (folder / "plan.html").read_text(encoding="utf-8")


@pytest.fixture
def _without_pictures(monkeypatch: pytest.MonkeyPatch) -> None:
    """For tests of the words: drawing takes most of a page's time."""
    for name in ("dose_histogram_png", "slices_png", "filmstrip_png", "frame_png"):
        monkeypatch.setattr(plan_page, name, lambda *_: b"")


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return written(a_plan(), tmp_path_factory.mktemp("plan"))


def dosed() -> Dosed:
    target = half_filled()
    return Dosed(dose_for(target), target >= 0.5, target < 0.5, 0.8, 0.85)


def test_page_reaches_for_nothing_outside_itself(page: str) -> None:
    reader = _Reader(page)
    assert all(link.startswith("data:image/png;base64,") for link in reader.links)
    assert not reader.tags & {"script", "link", "iframe", "object"}
    assert "url(" not in page
    assert "@import" not in page
    assert "prefers-color-scheme: dark" in page


def test_every_image_is_a_picture_and_is_described_in_words(page: str) -> None:
    images = _Reader(page).images
    assert len(images) == 4  # histograms, slices, filmstrip, frame
    for image in images:
        assert image["alt"]
        data = base64.b64decode((image["src"] or "").partition(",")[2], validate=True)
        assert Image.open(io.BytesIO(data)).format == "PNG"


def test_names_of_files_are_shown_not_obeyed(page: str) -> None:
    assert "<b>odd" not in page
    assert _Reader(page).text.startswith("<b>odd</b> & part.stl, object-space - vialight")


@pytest.mark.parametrize(
    "words",
    [
        "0.9877 Jaccard index", "a dose of 0.800", "-0.123 process window", "no dose separates", "0.346 in-part",
        "< 0.01 % voxel error rate", "1.68 % light efficiency", "3.67 mJ/cm² exposure per turn", "16.3 turns to cure",
        "294 s time to cure", "as the method believed", "does not cure", "voxel 0.5 mm", "passes not set",
        "passes done 5", "rotate 0, 90, -5°", "coverage no", "scale as placed 2", "2.000000", "16 x 16 x 12 of 0.5 mm",
        "columns 78 to 121", 'name = "DUDMA"', SHA, "cd" * 32, f"vialight {__version__}", "one every 30°",
    ],
)  # fmt: skip
def test_page_tells(page: str, words: str) -> None:
    assert words in _Reader(page).text


def test_voxels_that_cure_wrongly_are_counted(page: str) -> None:
    volume = int(half_filled().sum())
    assert f"{100 / volume:.2f} % does not cure and {200 / volume:.2f} % cures outside it" in _Reader(page).text


def test_the_same_plan_gives_the_same_file(page: str, tmp_path: Path) -> None:
    assert written(a_plan(), tmp_path) == page


@pytest.mark.usefixtures("_without_pictures")
def test_what_a_plan_does_not_know_is_said_to_be_missing(tmp_path: Path) -> None:
    projector = {key: value for key, value in RIG["projector"].items() if key != "irradiance_mw_per_cm2"}
    plan = replace(a_plan(projector=projector), settings={}, inputs={}, metrics={"exposure_per_turn_mj_per_cm2": None})
    text = _Reader(written(plan, tmp_path)).text
    assert "Part, method not recorded" in text
    assert "- exposure per turn the rig's projector has no irradiance_mw_per_cm2" in text
    assert "- turns to cure the rig's projector has no irradiance_mw_per_cm2" in text
    assert "- Jaccard index no threshold known" in text
    assert "what cures is not shown" in text


@pytest.mark.usefixtures("_without_pictures")
def test_turns_are_missing_where_the_resin_has_no_critical_exposure(tmp_path: Path) -> None:
    plan = replace(a_plan(resin={"index_writing": 1.49}), metrics=METRICS | {"turns_to_critical_exposure": None})
    text = _Reader(written(plan, tmp_path)).text
    assert "3.67 mJ/cm² exposure per turn" in text
    assert "- turns to cure the rig's resin has no critical_exposure_mj_per_cm2" in text


def test_part_that_fills_its_grid_and_telecentric_rig_are_drawn(tmp_path: Path) -> None:
    plan = replace(a_plan(geometry="parallel"), target=np.ones(GRID.shape, np.float32))
    assert len(_Reader(written(plan, tmp_path)).images) == 4


def test_rig_without_projector_is_refused_and_nothing_written(tmp_path: Path) -> None:
    plan = replace(a_plan(), rig=Rig())
    with pytest.raises(InputError, match="projector"):
        write_plan_page(tmp_path / "plan.html", plan, dose_for(plan.target))
    assert not list(tmp_path.iterdir())


def test_cuts_go_through_the_busiest_slice_and_the_parts_middle() -> None:
    xy, xz, yz = cuts_through(dosed(), a_plan())
    assert [plain(cut.title) for cut in (xy, xz, yz)] == ["XY, z = -0.75 mm", "XZ, y = -0.25 mm", "YZ, x = +0.25 mm"]
    target = half_filled()
    assert np.array_equal(xy.of(target), target[4])  # of three alike the one nearest to the middle
    assert xy.place == 4
    assert np.array_equal(xz.of(target), target[:, 7])
    assert np.array_equal(yz.of(target), target[:, :, 8])


def test_cut_moves_from_an_empty_middle_to_where_the_part_is() -> None:
    target = np.zeros(GRID.shape, np.float32)
    target[4:6, 1:3, 4] = target[4:6, 1:3, 14] = 1
    _, _, yz = cuts_through(Dosed(target, target > 0, target == 0, None, None), a_plan())
    assert yz.place == 4


def test_filmstrip_is_spread_evenly_and_named_by_stage_angle() -> None:
    patterns = a_plan().patterns
    assert filmstrip_indices(12) == [0, 1, 3, 4, 6, 7, 9, 10]
    assert [angle_words(patterns, index) for index in (0, 1, 7)] == ["0°", "30°", "210°"]


def test_outline_in_the_frame_is_that_of_the_turning_part() -> None:
    outline = swept_outline(a_plan(geometry="parallel"))
    widest = np.hypot(GRID.x_mm[12], GRID.y_mm[6]) + 0.25  # the block's farthest voxel, to its outer side
    columns, rows = outline.T
    assert np.isclose(np.ptp(columns), 2 * widest / 0.25)
    assert np.isclose(columns.mean(), 99.5, atol=10)
    # Row 0 is on top: the widest part, at the bottom of the grid, has the largest rows.
    assert rows[columns.argmax()] > 59.5
    assert np.isclose(rows.max(), 59.5 - GRID.z_mm[2] / 0.25)


def test_refraction_widens_the_outline() -> None:
    straight, refracted = (np.ptp(swept_outline(plan)[:, 0]) for plan in (a_plan(geometry="parallel"), a_plan()))
    assert refracted / straight == pytest.approx(1.49, rel=0.01)
