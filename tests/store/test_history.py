from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.messages import Snapshot, StopForecast, Sums, SurfaceSnapshot
from vialight.store import (
    list_history,
    list_surfaces,
    read_history,
    read_history_numbers,
    read_surface,
    write_history,
    write_ply,
)


def images(value: float) -> Sums:
    return Sums(
        np.full((6, 6), value, np.float32), np.full((4, 6), value + 1, np.float32), np.full((4, 6), value, np.float32)
    )


SNAPSHOT = Snapshot(200, 19.95, 39.0, 0.05, 10.0, 0.1, -1.5, images(2.0), images(0.5), 12.5, 0.0)
SURFACE = SurfaceSnapshot(
    199, 19.85, 12.0, np.zeros((3, 3), np.float32), np.array([[0, 1, 2]]), np.zeros(3, np.float32), 0.06, None, 0.97,
    12.4, images(100.0), images(np.nan), StopForecast(50.0, 0.7, "volume"),
)  # fmt: skip


def test_a_moment_comes_back_as_it_was_known(tmp_path: Path) -> None:
    path = write_history(tmp_path, SNAPSHOT, SURFACE)
    assert path == tmp_path / "history" / "000199.npz"
    moment = read_history(tmp_path, 199)
    assert (moment.numbers.frames, moment.numbers.time_s, moment.numbers.lit_s) == (200, 19.95, 12.0)
    assert (moment.numbers.rmse_mm, moment.numbers.stop_s, moment.numbers.sigma_s) == (0.06, 50.0, 0.7)
    assert np.isnan(moment.numbers.reverse_rmse_mm)
    assert (moment.voxel_mm, moment.centre_z_mm) == (0.1, -1.5)
    assert np.array_equal(moment.density.xz, images(2.0).xz)
    assert moment.slices is not None
    assert moment.gel_time_s is not None
    assert np.array_equal(moment.slices.xy, images(100.0).xy)
    assert np.isnan(moment.gel_time_s.yz).all()
    assert read_history_numbers(tmp_path, 199).iou == 0.97


def test_before_there_is_a_surface_there_are_no_slices_and_nothing_measured(tmp_path: Path) -> None:
    write_history(tmp_path, SNAPSHOT)
    moment = read_history(tmp_path, 199)
    assert moment.slices is None
    assert moment.gel_time_s is None
    assert np.isnan([moment.numbers.lit_s, moment.numbers.rmse_mm, moment.numbers.stop_s]).all()


def test_sums_beyond_half_precision_are_kept(tmp_path: Path) -> None:
    write_history(tmp_path, replace(SNAPSHOT, density=images(1e6)))
    assert read_history(tmp_path, 199).density.xy.max() == 1e6


def test_moments_are_listed_in_order_and_strangers_are_not(tmp_path: Path) -> None:
    for frames in (100, 20, 1_500_000):
        write_history(tmp_path, replace(SNAPSHOT, frames=frames))
    (tmp_path / "history" / "notes.npz").touch()
    assert list_history(tmp_path) == [19, 99, 1_499_999]


def test_a_missing_and_a_damaged_moment_say_so(tmp_path: Path) -> None:
    path = write_history(tmp_path, SNAPSHOT)
    with pytest.raises(InputError, match="no such moment"):
        read_history(tmp_path, 3)
    path.write_bytes(path.read_bytes()[:400])
    with pytest.raises(InputError, match="is damaged"):
        read_history(tmp_path, 199)


def test_surfaces_come_back_with_and_without_a_deviation(tmp_path: Path) -> None:
    (tmp_path / "surfaces").mkdir()
    corner = Mesh(
        np.array([[0.0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]]), np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    )
    write_ply(tmp_path / "surfaces" / "000009.ply", corner, {"deviation_mm": np.arange(4)}, np.zeros((4, 3), np.uint8))
    write_ply(tmp_path / "surfaces" / "000019.ply", corner)
    assert list_surfaces(tmp_path) == [9, 19]
    first, second = (read_surface(tmp_path, number) for number in (9, 19))
    assert np.array_equal(first.vertices_mm, corner.vertices_mm)
    assert np.array_equal(first.faces, corner.faces)
    assert first.deviation_mm.tolist() == [0, 1, 2, 3]
    assert second.deviation_mm.size == 0


@pytest.mark.parametrize("content", [b"", b"ply\nend_header\n", b"ply\nformat ascii 1.0\nend_header\n", None])
def test_a_surface_that_cannot_be_read_says_so(tmp_path: Path, content: bytes | None) -> None:
    (tmp_path / "surfaces").mkdir()
    if content is not None:
        (tmp_path / "surfaces" / "000009.ply").write_bytes(content)
    with pytest.raises(InputError, match="no such surface" if content is None else "is damaged"):
        read_surface(tmp_path, 9)


def test_a_surface_that_is_cut_short_says_so(tmp_path: Path) -> None:
    (tmp_path / "surfaces").mkdir()
    path = tmp_path / "surfaces" / "000009.ply"
    write_ply(path, Mesh(np.eye(3), np.array([[0, 1, 2]])))
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="is damaged"):
        read_surface(tmp_path, 9)
