"""The report: what it says, what it shows, and that it needs nothing but itself."""

from __future__ import annotations

import base64
import re
from dataclasses import dataclass
from datetime import UTC, datetime
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from vialight.core.drawing import round_up
from vialight.core.errors import InputError, VialightWarning
from vialight.core.mesh import Mesh
from vialight.metrology import Comparison, compare
from vialight.report import Provenance, colour_limit_mm, deviation_colours, write_report
from vialight.report.views import VIEWS, View, draw

WHEN = datetime(2026, 1, 2, 3, 4, tzinfo=UTC)


def mesh_of(source: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(source.vertices), np.asarray(source.faces))


def rod(radius_mm: float) -> Mesh:
    return mesh_of(trimesh.creation.cylinder(radius_mm, 6, sections=48))


@dataclass(frozen=True)
class Picture:
    title: str
    caption: str
    png: bytes


@pytest.fixture(scope="module")
def comparison() -> Comparison:
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_rotvec((0.1, 0, 0)).as_matrix()
    return compare(rod(2.045).moved(tilt), rod(2.0), tolerance_mm=0.02)


@pytest.fixture(scope="module")
def page(comparison: Comparison, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("report") / "report.html"
    provenance = Provenance(
        inputs={
            "print": {"file": "<b>odd</b> & name.stl", "sha256": "ab" * 32},
            "reference": {"file": "r.stl", "sha256": "cd" * 32},
        },
        settings={"align": "rigid", "tolerance_mm": 0.02},
        versions={"vialight": "9.8.7"},
        created=WHEN,
    )  # fmt: skip
    extra = Picture("A raw frame", "The vial's edges & its axis", base64.b64decode(ONE_PIXEL))
    write_report(path, comparison, provenance=provenance, figures=[extra])
    return path.read_text(encoding="utf-8")


ONE_PIXEL = "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAYAAAAfFcSJAAAADUlEQVR42mNk+M9QDwADhgGAWjR9awAAAABJRU5ErkJggg=="


class _Reader(HTMLParser):
    """Gathers what stands in a page: text, images, and all that would reach outside."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.text = ""
        self.images: list[dict[str, str | None]] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        if tag == "img":
            self.images.append(dict(attrs))
        self.links += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "data", "action")]

    def handle_data(self, data: str) -> None:
        self.text += data


def test_page_reaches_for_nothing_outside_itself(page: str) -> None:
    reader = _Reader(page)
    assert all(link.startswith("data:image/png;base64,") for link in reader.links)
    assert not reader.tags & {"script", "link", "iframe", "object"}
    assert "url(" not in page
    assert "@import" not in page


def test_every_image_is_a_picture_and_is_described_in_words(page: str) -> None:
    images = _Reader(page).images
    assert len(images) == 4  # views, histogram, projections, and the one that was added
    for image in images:
        assert image["alt"]
        assert base64.b64decode((image["src"] or "").partition(",")[2], validate=True).startswith(b"\x89PNG")


def test_names_of_files_are_shown_not_obeyed(page: str) -> None:
    assert "<b>odd" not in page
    assert "<b>odd</b> & name.stl" in _Reader(page).text


def test_page_tells_all_that_was_measured(page: str, comparison: Comparison) -> None:
    text = " ".join(_Reader(page).text.split())
    reported = comparison.reported
    assert f"{reported.forward.rmse_mm:.3f} mm / {reported.reverse.rmse_mm:.3f} mm" in text
    assert f"{100 * reported.forward.rmse_mm / 6:.2f} %" in text
    assert f"{reported.iou:.4f}" in text
    assert "FAIL" in text
    assert "rotation about z" in text
    assert "ab" * 32 in text
    assert "cd" * 32 in text
    assert "vialight 9.8.7" in text
    assert "tolerance mm" in text
    assert "2026-01-02 03:04" in text
    (cylinder,) = comparison.cylinders
    assert f"{cylinder.diameter_mm:.3f} mm" in text
    assert "6.000 mm" in text  # the height
    assert "A raw frame" in text
    assert "The vial's edges & its axis" in text
    for row in comparison.transform:
        assert f"{row[0] + 0.0:.6f}" in text


def test_the_same_inputs_give_the_same_file(comparison: Comparison, tmp_path: Path) -> None:
    first, second = tmp_path / "1.html", tmp_path / "2.html"
    for path in (first, second):
        write_report(path, comparison, provenance=Provenance(created=WHEN))
    assert first.read_bytes() == second.read_bytes()


def test_open_reference_is_explained_and_leaves_out_what_it_cannot_have(tmp_path: Path) -> None:
    open_rod = Mesh(rod(2).vertices_mm, rod(2).faces[1:])
    with pytest.warns(VialightWarning):
        result = compare(rod(2.05), open_rod, align="none")
    write_report(tmp_path / "report.html", result)
    page = _Reader((tmp_path / "report.html").read_text(encoding="utf-8"))
    text = " ".join(page.text.split())
    assert "The reference is not watertight" in text
    assert "no tolerance given" in text
    assert "measured as placed" in text
    assert len(page.images) == 2
    assert "nan" not in re.findall(r"[a-z]+", text.lower())
    assert "None" not in text


def test_report_into_a_missing_folder_is_refused(comparison: Comparison, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="missing"):
        write_report(tmp_path / "missing" / "report.html", comparison)


def test_missing_is_blue_none_is_white_too_much_is_red() -> None:
    blue, white, red = deviation_colours([-0.2, 0.0, 0.2], 0.2).astype(int)
    assert blue[2] > blue[0] + 80
    assert red[0] > red[2] + 80
    assert (white == 255).all()


def test_colours_are_symmetric_in_lightness_order() -> None:
    ramp = deviation_colours(np.linspace(-1, 1, 101), 1.0).astype(int).sum(axis=1)
    assert (np.diff(ramp[:51]) >= 0).all()
    assert (np.diff(ramp[50:]) <= 0).all()


def test_beyond_the_limit_the_ends_colour_is_kept() -> None:
    np.testing.assert_array_equal(deviation_colours([-9, 9], 0.1), deviation_colours([-0.1, 0.1], 0.1))


def test_the_scale_ends_at_a_round_deviation(comparison: Comparison) -> None:
    assert colour_limit_mm(comparison) == round_up(0.05)
    assert [round_up(value) for value in (0.05, 0.051, 0.1, 0.11)] == [0.05, 0.1, 0.1, 0.2]


def _seen(view: View, at_mm: tuple[float, float, float]) -> np.ndarray:
    """Colour seen at a point of a grey block whose corner (+, +, +) is green and whose corner (-, -, +) is red."""
    block = trimesh.creation.box((4, 4, 4)).subdivide().subdivide().subdivide()
    mesh = mesh_of(block)
    colours = np.full((len(mesh.vertices_mm), 3), 128, dtype=np.uint8)
    colours[np.linalg.norm(mesh.vertices_mm - [2, 2, 2], axis=1) < 1.6] = (0, 255, 0)
    colours[np.linalg.norm(mesh.vertices_mm - [-2, -2, 2], axis=1) < 1.6] = (255, 0, 0)
    drawing = draw(mesh, colours, view, 0.05)
    left, _, _, top = drawing.extent_mm
    x, y = view.axes[:2] @ at_mm
    return np.asarray(drawing.image[int((top - y) / 0.05), int((x - left) / 0.05)], dtype=int)


@pytest.mark.parametrize(
    ("index", "green_at", "red_at"), [(0, None, (-1.7, 0, 1.7)), (1, (1.7, 1.7, 0), (-1.7, -1.7, 0))]
)
def test_views_are_not_mirrored(
    index: int, green_at: tuple[float, float, float] | None, red_at: tuple[float, float, float]
) -> None:
    red = _seen(VIEWS[index], red_at)
    assert red[0] > red[1] + 60
    if green_at is None:  # it lies at the back
        other = _seen(VIEWS[index], (1.7, 0, 1.7))
        assert abs(other[0] - other[1]) < 5
    else:
        green = _seen(VIEWS[index], green_at)
        assert green[1] > green[0] + 60


def test_all_views_are_right_handed_and_one_of_them_shows_each_side() -> None:
    towards = np.array([view.axes[2] for view in VIEWS])
    for view in VIEWS:
        np.testing.assert_allclose(view.axes @ view.axes.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(view.axes) == pytest.approx(1)
    assert (towards.max(axis=0) > 0.3).all()
    assert (towards.min(axis=0) < -0.3).all()


def test_what_is_near_hides_what_is_far_and_around_it_nothing_is_drawn() -> None:
    near, far = mesh_of(trimesh.creation.box((1, 1, 1))), mesh_of(trimesh.creation.box((3, 1, 3)))
    vertices = np.vstack([near.vertices_mm - np.array([0, 5, 0]), far.vertices_mm])
    both = Mesh(vertices, np.vstack([near.faces, far.faces + len(near.vertices_mm)]))
    colours = np.repeat(np.array([[255, 0, 0], [0, 0, 255]], dtype=np.uint8), [8, 8], axis=0)
    image = draw(both, colours, VIEWS[0], 0.05).image.astype(int)
    rows, columns = image.shape[:2]
    middle, side, corner = image[rows // 2, columns // 2], image[rows // 2, 8], image[0, 0]
    assert middle[0] > 100 > middle[2]
    assert side[2] > 100 > side[0]
    assert corner[3] == 0


def test_pictures_are_large_enough_to_read(page: str, tmp_path: Path) -> None:
    for image in _Reader(page).images[:3]:
        (tmp_path / "i.png").write_bytes(base64.b64decode((image["src"] or "").partition(",")[2]))
        with Image.open(tmp_path / "i.png") as picture:
            assert picture.width > 1000
