"""The rays of the sinogram, the rows and heights that belong to them, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vialight.core.arrays import FloatArray
from vialight.core.config import Camera, Optics
from vialight.core.errors import InputError
from vialight.optics.refraction import camera_to_virtual
from vialight.optics.viewing import heights_seen, ray_tilt
from vialight.tomography.sinogram import parallel_beam, rows_seen

OPTICS = Optics(12.4, 11.3, 1.472, 1.48, 190.0)
TURN = np.radians(np.arange(0.0, 360.0, 2.0))


def camera_at(axis_column: float, pixel_mm: float = 0.155) -> Camera:
    return Camera(distance_mm=190.0, pixel_mm=pixel_mm, axis_column=axis_column, optical_row=59.5)


@pytest.mark.parametrize("count", [3, 4, 17, 180, 181])
@pytest.mark.parametrize("span", [180.0, 360.0])
def test_views_are_even_in_number_over_a_full_turn_and_begin_with_the_first_frame(count: int, span: float) -> None:
    angles = 0.3 + np.radians(span) / count * np.arange(count)
    beam = parallel_beam(angles, 9, camera_at(4.0, 1.0), None)
    assert len(beam.psi_rad) % 2 == 0
    assert beam.psi_rad[0] == 0.3
    np.testing.assert_allclose(np.diff(beam.psi_rad), 2 * np.pi / len(beam.psi_rad))
    assert abs(len(beam.psi_rad) - count * 360 / span) <= 1


@given(st.integers(2, 40), st.floats(0, 1))
def test_parallel_rays_reach_the_farther_edge_of_the_image_and_no_farther(columns: int, share: float) -> None:
    axis = share * (columns - 1)
    beam = parallel_beam(TURN, columns, camera_at(axis, 0.5), None)
    np.testing.assert_allclose(beam.virtual_x_mm, -beam.virtual_x_mm[::-1])
    farthest = 0.5 * max(axis, columns - 1 - axis)
    assert farthest - 1e-9 <= beam.virtual_x_mm[-1] <= farthest + 0.5


@pytest.mark.parametrize("axis", [7.0, 7.5])
def test_parallel_rays_fall_on_columns_where_the_axis_does(axis: float) -> None:
    beam = parallel_beam(TURN, int(2 * axis) + 1, camera_at(axis, 1.0), None)
    np.testing.assert_array_equal(beam.virtual_x_mm + axis, np.arange(2 * axis + 1))


def test_rays_in_the_vial_fill_the_field_at_the_columns_distance_in_resin() -> None:
    beam = parallel_beam(TURN, 176, camera_at(87.9), OPTICS)
    assert beam.spacing_mm == pytest.approx(0.155 / 1.48)
    assert OPTICS.field_radius_mm - beam.spacing_mm <= beam.virtual_x_mm[-1] <= OPTICS.field_radius_mm


@pytest.mark.parametrize("axis", [-0.1, 175.1, 400.0])
@pytest.mark.parametrize("optics", [None, OPTICS])
def test_an_axis_outside_the_image_is_refused(axis: float, optics: Optics | None) -> None:
    with pytest.raises(InputError, match=r"\[camera\]: axis_column .* outside the image; accepted: 0 to 175"):
        parallel_beam(TURN, 176, camera_at(axis), optics)


def test_a_vial_wider_than_the_image_is_refused_with_where_it_would_end() -> None:
    # D = 190 mm sees the edge of 12.4 mm at 12.4 / sqrt(1 - (12.4/190)^2) = 12.427 mm = 80.2 columns.
    with pytest.raises(InputError, match=r"the vial spans columns -5\..* to 155\.\d, the image has 0 to 149"):
        parallel_beam(TURN, 150, camera_at(75.0), OPTICS)


@pytest.mark.parametrize("axis", [30.0, 87.5, 140.0])
def test_a_vial_seen_to_its_edge_on_one_side_is_enough(axis: float) -> None:
    assert len(parallel_beam(TURN, 176, camera_at(axis), OPTICS).psi_rad) == 180


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_frames_are_refused(count: int) -> None:
    with pytest.raises(InputError, match=rf"{count} frames in the turn; accepted: 3 or more"):
        parallel_beam(TURN[:count], 176, camera_at(87.5), None)


def edge_heights(row: float, camera: Camera, columns: FloatArray) -> FloatArray:
    x_c = (columns - camera.axis_column) * camera.pixel_mm
    return camera_to_virtual(x_c, (camera.optical_row - row) * camera.pixel_mm, OPTICS).mid_height_mm


@pytest.mark.parametrize("optical_row", [-20.0, 59.5, 130.0])
def test_heights_seen_are_seen_by_every_column(optical_row: float) -> None:
    camera = camera_at(87.5).model_copy(update={"optical_row": optical_row})
    low, high = heights_seen(120, camera, OPTICS)
    columns = np.linspace(7.5, 167.5, 321)
    assert low == pytest.approx(np.nanmax(edge_heights(119, camera, columns)), abs=0.01)
    assert high == pytest.approx(np.nanmin(edge_heights(0, camera, columns)), abs=0.01)


def test_without_a_vial_heights_are_those_of_the_rows() -> None:
    camera = Camera(pixel_mm=0.5, axis_column=3, optical_row=2.0)
    assert heights_seen(11, camera, None) == (-4.0, 1.0)


@given(st.floats(-9, 9), st.floats(0.1, 4))
def test_rows_seen_hold_every_height_of_the_stack_in_every_column(bottom: float, depth: float) -> None:
    camera, z_mm = camera_at(87.5), bottom + np.linspace(0, depth, 5)
    rows = rows_seen(z_mm, 120, camera, OPTICS)
    for row, outer, inner in ((rows.start, max, z_mm[-1]), (rows.stop - 1, min, z_mm[0])):
        if 0 < row < 119:
            reached = edge_heights(row, camera, np.linspace(8, 167, 60))
            assert outer(inner, np.nanmin(reached), np.nanmax(reached)) != inner
            assert (np.sign(reached - inner) == (1 if outer is max else -1)).all()


@pytest.mark.parametrize("z", [0.5, 4.0, 10.0])
def test_the_climb_of_a_ray_is_proportional_to_its_height(z: float) -> None:
    """To 0.3 %, that is 1 um at the ends of a tall print."""
    x_c = np.linspace(-11.5, 11.5, 47)
    rays = camera_to_virtual(x_c, z, OPTICS)
    np.testing.assert_allclose(ray_tilt(rays.virtual_x_mm, OPTICS), rays.slope / rays.mid_height_mm, rtol=3e-3)


def test_the_climb_on_the_axis_is_that_of_a_ray_from_the_apparent_pupil() -> None:
    # Small heights: 190 mm of air seen as 177.6 + 1.1/1.472 + 11.3/1.48 mm from the axis, climbing 1/1.48 as steeply.
    expected = 1 / 1.48 / (190 - 12.4 + 1.1 / 1.472 + 11.3 / 1.48)
    assert ray_tilt(np.zeros(1), OPTICS)[0] == pytest.approx(expected, rel=1e-3)
    assert np.isfinite(ray_tilt(np.array([-9.0, 9.0]), OPTICS)).all()
