from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import zarr
from ome_zarr.io import parse_url
from ome_zarr.reader import Reader

from vialight.core.arrays import Float32Array, Grid
from vialight.core.errors import InputError
from vialight.store import VolumeSeriesWriter, read_series

GRID = Grid((20, 6, 4), 0.155, centre_z_mm=0.25)
TIMES_S = [18.0, 36.1, 54.0]


def volume(number: int) -> Float32Array:
    return np.random.default_rng(number).normal(100, 30, GRID.shape).astype(np.float32)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "volumes.zarr"
    series = VolumeSeriesWriter(path, GRID, {"threshold": 98.5})
    for number, time_s in enumerate(TIMES_S):
        series.append(volume(number), time_s=time_s, lit_s=time_s - 1)
    return path


def test_volumes_come_back_with_all_that_is_known_of_them(written: Path) -> None:
    back = read_series(written)
    assert back.grid == GRID
    assert back.time_s.tolist() == TIMES_S
    assert back.moments["lit_s"].tolist() == [17.0, 35.1, 53.0]
    for number in range(3):
        np.testing.assert_array_equal(back.volume(number).density, volume(number))
    with pytest.raises(InputError, match="has no volume 3"):
        back.volume(3)


def test_ome_zarr_reads_them_true_to_size_and_time(written: Path) -> None:
    location = parse_url(written)
    assert location is not None
    (node,) = Reader(location)()
    assert [(axis["name"], axis["type"], axis["unit"]) for axis in node.metadata["axes"]] == [
        ("t", "time", "second"), ("z", "space", "millimeter"), ("y", "space", "millimeter"),
        ("x", "space", "millimeter"),
    ]  # fmt: skip
    ((scale, translation),) = node.metadata["coordinateTransformations"]
    np.testing.assert_allclose(scale["scale"], [18.0, 0.155, 0.155, 0.155], rtol=1e-12)
    np.testing.assert_allclose(translation["translation"], [18.0, GRID.z_mm[0], GRID.y_mm[0], GRID.x_mm[0]])
    assert node.data[0].shape == (3, *GRID.shape)
    np.testing.assert_array_equal(np.asarray(node.data[0][1]), volume(1))


def test_times_that_the_scale_cannot_hold_stand_beside_it(written: Path) -> None:
    own = json.loads((written / "zarr.json").read_text())["attributes"]["vialight"]
    assert own["moments"]["time_s"] == TIMES_S
    assert own["threshold"] == 98.5


def test_a_reader_sees_whole_volumes_only_while_one_is_written(written: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    series = VolumeSeriesWriter(written, GRID)
    seen: list[int] = []

    def between_looks(step: Callable[..., None]) -> Callable[..., None]:
        def taken(*given: object) -> None:
            look()
            step(*given)
            look()

        return taken

    def look() -> None:
        back = read_series(written)
        seen.append(len(back))
        np.testing.assert_array_equal(back.volume(len(back) - 1).density, volume(len(back) - 1))

    for step in ("_place", "_describe"):
        monkeypatch.setattr(series, step, between_looks(getattr(series, step)))
    series.append(volume(3), time_s=72.0, lit_s=71.0)
    assert seen == [3, 3, 3, 4]


def test_a_series_is_gone_on_with_after_its_writer_was_killed(tmp_path: Path) -> None:
    path = tmp_path / "volumes.zarr"
    code = f"""
import sys, numpy as np
from pathlib import Path
from vialight.core.arrays import Grid
from vialight.store import VolumeSeriesWriter
series = VolumeSeriesWriter(Path(sys.argv[1]), Grid({GRID.shape}, 0.155, 0.25))
k = 0
while True:
    k += 1
    series.append(np.full({GRID.shape}, k, np.float32), time_s=float(k))
    print(k, flush=True)
"""
    with subprocess.Popen([sys.executable, "-c", code, str(path)], stdout=subprocess.PIPE, text=True) as writer:
        assert writer.stdout is not None
        written = [int(writer.stdout.readline()) for _ in range(5)]
        os.kill(writer.pid, signal.SIGKILL)
    back = read_series(path)
    assert len(back) >= written[-1]
    assert all((back.volume(k).density == k + 1).all() for k in range(len(back)))
    series = VolumeSeriesWriter(path, GRID)
    series.append(volume(9), time_s=1000.0)
    again = read_series(path)
    assert len(again) == len(back) + 1
    np.testing.assert_array_equal(again.volume(len(back)).density, volume(9))
    assert sorted(item.name for item in tmp_path.iterdir()) == ["volumes.zarr"]


def test_a_series_that_ended_before_its_first_volume_is_begun_anew(tmp_path: Path) -> None:
    path = tmp_path / "volumes.zarr"
    VolumeSeriesWriter(path, GRID)
    with pytest.raises(InputError, match="holds no volume yet"):
        read_series(path)
    VolumeSeriesWriter(path, Grid((2, 4, 4), 0.1)).append(np.ones((2, 4, 4), np.float32), time_s=1.0)
    assert len(read_series(path)) == 1


def test_what_does_not_fit_is_refused(written: Path, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="volumes of another grid"):
        VolumeSeriesWriter(written, Grid((20, 6, 4), 0.2))
    with pytest.raises(InputError, match="has the shape"):
        VolumeSeriesWriter(written, GRID).append(volume(0)[:3], time_s=99.0)
    (tmp_path / "plain").mkdir()
    with pytest.raises(InputError, match="is not a zarr"):
        VolumeSeriesWriter(tmp_path / "plain", GRID)
    zarr.create_group(tmp_path / "g.zarr", zarr_format=3).create_array("0", shape=(2, 2), dtype="f4")
    with pytest.raises(InputError, match="is not an image over time"):
        read_series(tmp_path / "g.zarr")


def fill(series: VolumeSeriesWriter, density: Float32Array) -> None:
    for number in range(1, 100):
        series.append(density, time_s=float(number))


def test_a_full_disk_keeps_what_was_written(small_disk: Path) -> None:
    grid = Grid((32, 100, 100), 0.1)
    series = VolumeSeriesWriter(small_disk / "v.zarr", grid)
    noise = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    series.append(noise, time_s=0.0)
    with pytest.raises(InputError, match=r"the disk is full .*volumes are safe"):
        fill(series, noise)
    back = read_series(small_disk / "v.zarr")
    assert len(back) > 0
    np.testing.assert_array_equal(back.volume(len(back) - 1).density, noise)
