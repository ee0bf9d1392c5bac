from __future__ import annotations

import itertools
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from ome_zarr.io import parse_url
from ome_zarr.reader import Reader

from vialight.core.arrays import Float32Array, Grid, Volume
from vialight.core.errors import InputError
from vialight.store import VolumeWriter, read_volume, staged_folder, write_volume

GRID = Grid((37, 6, 5), 0.155, centre_z_mm=0.1234567890123456)
DENSITY: Float32Array = np.random.default_rng(0).normal(100, 30, GRID.shape).astype(np.float32)
VOLUME = Volume(DENSITY, GRID)


@pytest.fixture
def written(tmp_path: Path) -> Path:
    path = tmp_path / "volume.zarr"
    write_volume(path, VOLUME, {"threshold": 98.5})
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        read_volume(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def change_metadata(path: Path, change: dict[str, Any]) -> None:
    file = path / "zarr.json"
    content = json.loads(file.read_text())
    content["attributes"]["ome"]["multiscales"][0] |= change
    file.write_text(json.dumps(content))


def test_a_volume_comes_back_exactly(written: Path) -> None:
    back = read_volume(written)
    assert back.grid == GRID
    assert back.density.dtype == np.float32
    np.testing.assert_array_equal(back.density, DENSITY)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    shape=st.tuples(st.integers(1, 40), st.integers(1, 5), st.integers(1, 5)),
    cuts=st.lists(st.integers(1, 39), max_size=5),
    order=st.randoms(use_true_random=False),
)
def test_blocks_of_any_size_in_any_order_make_the_same_volume(
    tmp_path: Path, shape: tuple[int, int, int], cuts: list[int], order: Any
) -> None:
    path = tmp_path / "volume.zarr"
    shutil.rmtree(path, ignore_errors=True)
    density = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    edges = sorted({0, shape[0], *(cut for cut in cuts if cut < shape[0])})
    blocks = list(itertools.pairwise(edges))
    order.shuffle(blocks)
    with VolumeWriter(path, Grid(shape, 0.1)) as writer:
        for start, stop in blocks:
            writer[start:stop] = density[start:stop]
    np.testing.assert_array_equal(read_volume(path).density, density)


def test_every_shard_is_written_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    grid = Grid((40, 4, 4), 0.1)
    with VolumeWriter(tmp_path / "volume.zarr", grid) as writer:
        written: list[slice] = []
        monkeypatch.setattr(
            writer, "_array", type("Log", (), {"__setitem__": lambda _, key, __: written.append(key)})()
        )
        for start in range(0, 40, 5):
            writer[start : start + 5] = np.zeros((5, 4, 4), np.float32)
    assert written == [slice(0, 16), slice(16, 32), slice(32, 40)]


def test_memory_of_a_streamed_volume_is_that_of_a_few_slices(tmp_path: Path) -> None:
    code = """
import resource, sys
import numpy as np
from vialight.core.arrays import Grid
from vialight.store import VolumeWriter
block = np.zeros((10, 300, 300), np.float32)
with VolumeWriter(sys.argv[1], Grid((640, 300, 300), 0.1)) as writer:  # 230 MB
    for start in range(0, 640, 10):
        writer[start : start + 10] = block
        if start == 50:
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
"""
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "v.zarr")], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 40_000  # kB


def test_ome_zarr_reads_it_true_to_size(written: Path) -> None:
    location = parse_url(written)
    assert location is not None
    (node,) = Reader(location)()
    assert [(axis["name"], axis["type"], axis["unit"]) for axis in node.metadata["axes"]] == [
        (name, "space", "millimeter") for name in "zyx"
    ]
    ((scale, translation),) = node.metadata["coordinateTransformations"]
    assert scale == {"type": "scale", "scale": [0.155] * 3}
    assert translation["type"] == "translation"
    np.testing.assert_allclose(translation["translation"], [GRID.z_mm[0], GRID.y_mm[0], GRID.x_mm[0]], rtol=1e-15)
    np.testing.assert_array_equal(np.asarray(node.data[0]), DENSITY)
    assert node.metadata["name"] == "volume"


def test_it_is_ome_zarr_05_sharded_with_what_its_values_mean(written: Path) -> None:
    group = zarr.open_group(written, mode="r", zarr_format=3)
    assert group.attrs["ome"]["version"] == "0.5"  # type: ignore[index,call-overload]
    own = group.attrs["vialight"]
    assert isinstance(own, dict)
    assert own["unit"] == "counts per mm"
    assert own["threshold"] == 98.5
    array = group["0"]
    assert isinstance(array, zarr.Array)
    assert array.dtype == np.float32
    assert array.shards == (16, 6, 5)
    assert array.metadata.dimension_names == ("z", "y", "x")  # type: ignore[union-attr]


def test_an_image_larger_than_a_chunk_comes_back(tmp_path: Path) -> None:
    grid = Grid((3, 301, 130), 0.1)
    density = np.random.default_rng(1).normal(size=grid.shape).astype(np.float32)
    write_volume(tmp_path / "v.zarr", Volume(density, grid))
    np.testing.assert_array_equal(read_volume(tmp_path / "v.zarr").density, density)


def test_a_volume_with_slices_missing_cannot_be_closed_or_read(tmp_path: Path) -> None:
    path = tmp_path / "volume.zarr"
    writer = VolumeWriter(path, GRID)
    writer[0:30] = DENSITY[:30]
    with pytest.raises(ValueError, match="not all of slices 16 to 31 were written"):
        writer.close()
    assert "was never finished" in refusal(path)


def test_a_failure_while_writing_is_not_hidden_by_the_unfinished_volume(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError), VolumeWriter(tmp_path / "v.zarr", GRID) as writer:
        writer[0:1] = DENSITY[:1] * (1 // 0)


@pytest.mark.parametrize(("key", "block"), [(slice(0, 3), DENSITY[:2]), (slice(0, 4, 2), DENSITY[:2])])
def test_a_block_that_does_not_fit_is_refused(tmp_path: Path, key: slice, block: Float32Array) -> None:
    writer = VolumeWriter(tmp_path / "v.zarr", GRID)
    with pytest.raises(InputError, match="the block has the shape"):
        writer[key] = block


def test_writing_replaces_a_zarr_and_nothing_else(written: Path, tmp_path: Path) -> None:
    write_volume(written, Volume(DENSITY[:5], Grid((5, 6, 5), 0.155)))
    assert read_volume(written).grid.shape == (5, 6, 5)
    home = tmp_path / "home"
    home.mkdir()
    (home / "letter.txt").write_text("dear")
    with pytest.raises(InputError, match="is not a zarr"):
        write_volume(home, VOLUME)
    assert (home / "letter.txt").read_text() == "dear"
    with pytest.raises(InputError, match="exists already"):
        VolumeWriter(home, GRID)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["home", "volume.zarr"]


def test_a_missing_volume_is_named(tmp_path: Path) -> None:
    assert "no such folder" in refusal(tmp_path / "none.zarr")


def test_a_folder_or_file_that_is_no_zarr_is_refused(tmp_path: Path) -> None:
    assert "holds no zarr.json" in refusal(tmp_path)
    (tmp_path / "file.zarr").write_text("?")
    assert "holds no zarr.json" in refusal(tmp_path / "file.zarr")


def test_a_zarr_that_is_no_image_is_refused(tmp_path: Path) -> None:
    zarr.create_group(tmp_path / "v.zarr", zarr_format=3)
    assert "is not an image" in refusal(tmp_path / "v.zarr")


@pytest.mark.parametrize("file", ["zarr.json", "0/zarr.json"])
@pytest.mark.parametrize("content", [b"", b'{"zarr_format": 3', b"\xff\xfe", b"{}", b"[]"])
def test_damaged_metadata_is_told(written: Path, file: str, content: bytes) -> None:
    (written / file).write_bytes(content)
    assert re.search(r": is damaged|: is not an image", refusal(written))


def test_a_lost_shard_is_told_and_not_read_as_zeros(written: Path) -> None:
    (written / "0" / "c" / "1" / "0" / "0").unlink()
    assert "1 shards are missing" in refusal(written)


def test_a_truncated_shard_is_told(written: Path) -> None:
    shard = written / "0" / "c" / "1" / "0" / "0"
    shard.write_bytes(shard.read_bytes()[:200])
    assert "is damaged" in refusal(written)


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"axes": [{"name": name, "type": "space", "unit": "micrometer"} for name in "zyx"]}, "micrometer"),
        ({"axes": [{"name": name, "type": "space", "unit": "millimeter"} for name in "xyz"]}, "has the axes"),
    ],
)
def test_other_units_or_axes_are_refused_not_guessed(written: Path, change: dict[str, Any], complaint: str) -> None:
    change_metadata(written, change)
    assert complaint in refusal(written)


@pytest.mark.parametrize(
    ("scale", "translation"), [([0.1, 0.2, 0.2], [0, -0.5, -0.4]), ([0.155] * 3, [-2.666543, 0.0, 0.0])]
)
def test_a_grid_that_vialight_does_not_have_is_refused(
    written: Path, scale: list[float], translation: list[float]
) -> None:
    transforms = [{"type": "scale", "scale": scale}, {"type": "translation", "translation": translation}]
    change_metadata(written, {"datasets": [{"path": "0", "coordinateTransformations": transforms}]})
    assert "centred on the rotation axis" in refusal(written)


def test_a_volume_into_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no folder .*nowhere"):
        write_volume(tmp_path / "nowhere" / "v.zarr", VOLUME)


def test_a_full_disk_leaves_no_half_of_a_volume(small_disk: Path) -> None:
    grid = Grid((64, 200, 200), 0.1)
    noise = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    with pytest.raises(
        InputError, match=r"v\.zarr: the disk is full \(\d\.\d MB free\); nothing was left half-written"
    ):
        write_volume(small_disk / "v.zarr", Volume(noise, grid))
    assert not list(small_disk.iterdir())
    out = small_disk / "out"
    with pytest.raises(InputError, match=r"out: the disk is full"), staged_folder(out) as folder:
        write_streamed(folder / "v.zarr", Volume(noise, grid))
    assert not list(small_disk.iterdir())


def write_streamed(path: Path, volume: Volume) -> None:
    with VolumeWriter(path, volume.grid) as writer:
        writer[:] = volume.density
