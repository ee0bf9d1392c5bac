"""What is measured on the live volume about once a second."""

from __future__ import annotations

import numpy as np
import pytest

from vialight.core.arrays import Grid, Volume
from vialight.metrology.surface import isosurface
from vialight.printing.live import analysis
from vialight.printing.live.analysis import coarser, measure, yardstick

RADIUS_MM = 3.0


def ball(shape: tuple[int, int, int]) -> Volume:
    """A ball whose edge lies where its density is 1."""
    grid = Grid(shape, 0.2, centre_z_mm=0.3)
    z, y, x = np.meshgrid(grid.z_mm - 0.3, grid.y_mm, grid.x_mm, indexing="ij")
    return Volume((1 + RADIUS_MM - np.sqrt(x**2 + y**2 + z**2)).astype(np.float32), grid)


@pytest.mark.parametrize("shape", [(40, 40, 40), (41, 40, 39)])
def test_coarser_volume_has_its_surface_in_the_same_place(shape: tuple[int, int, int]) -> None:
    volume = coarser(ball(shape))
    assert volume.grid.voxel_mm == 0.4
    found = measure(volume, 1.0, None).surface
    assert found is not None
    from_centre = np.linalg.norm(found.vertices_mm - [0, 0, 0.3], axis=1)
    assert np.abs(from_centre - RADIUS_MM).max() < 0.03


def test_surface_of_too_many_vertices_is_drawn_coarser_and_measured_all_the_same(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    volume = ball((40, 40, 40))
    against = yardstick(isosurface(volume, 1.0), volume.grid)
    fine = measure(volume, 1.0, against)
    monkeypatch.setattr(analysis, "_MOST_VERTICES", 2000)
    coarse = measure(volume, 1.0, against)
    assert fine.surface is not None
    assert coarse.surface is not None
    assert len(fine.surface.vertices_mm) > 2000 >= len(coarse.surface.vertices_mm) > 500
    assert coarse.iou == fine.iou
    assert coarse.rmse_mm is not None
    assert coarse.rmse_mm < 0.05
