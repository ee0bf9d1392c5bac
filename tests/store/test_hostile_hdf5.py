"""Recordings and plans that state what is not there, or name what is not theirs, are refused in time."""

from __future__ import annotations

import os
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest

from hostile import read_frames, refused
from vialight.core.arrays import Grid
from vialight.core.config import Rig
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.core.plan import Patterns, Plan
from vialight.store import open_frames, read_plan, write_frames, write_plan

COUNTS = np.arange(6 * 4 * 5, dtype=np.uint16).reshape(6, 4, 5)


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run" / "frames.h5"
    path.parent.mkdir()
    write_frames(path, COUNTS, np.radians(np.arange(6) * 60), dark=COUNTS[:2], time_s=np.arange(6.0))
    return path


def in_place_of(name: str, make: Callable[[h5py.File, str], object]) -> Callable[[Path], None]:
    def harm(path: Path) -> None:
        with h5py.File(path, "r+") as file:
            if name in file:
                del file[name]
            make(file, name)

    return harm


def unwritten(shape: tuple[int, ...], dtype: str = "u2", **options: object) -> Callable[[h5py.File, str], object]:
    return lambda file, name: file.create_dataset(name, shape, dtype, **options)


def packed_zeros(
    shape: tuple[int, ...], chunks: tuple[int, ...], dtype: str = "u2"
) -> Callable[[h5py.File, str], None]:
    """All chunks of zeros, without computing more than one."""

    def make(file: h5py.File, name: str) -> None:
        data = file.create_dataset(name, shape, dtype, chunks=chunks, compression="gzip", compression_opts=9)
        zeros = zlib.compress(bytes(int(np.prod(chunks)) * data.dtype.itemsize), 9)
        for first in range(0, shape[0], chunks[0]):
            data.id.write_direct_chunk((first, *(0,) * (len(shape) - 1)), zeros)

    return make


def one_chunk_of_gigabytes(file: h5py.File, name: str) -> None:
    data = file.create_dataset(name, (2, 4, 5), "u2", chunks=(1, 4, 5), compression="gzip")
    packer = zlib.compressobj(9)
    packed = [packer.compress(bytes(10_000_000)) for _ in range(400)]
    data.id.write_direct_chunk((0, 0, 0), b"".join([*packed, packer.flush()]))


def of_large_frames(make: Callable[[h5py.File, str], object]) -> Callable[[h5py.File, str], object]:
    def both(file: h5py.File, name: str) -> None:
        make(file, name)
        del file["exchange/data_dark"]

    return both


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (in_place_of("exchange/data_dark", unwritten((2**40 // 20, 4, 5), chunks=(1, 4, 5))), "data_dark: is uint16"),
        (in_place_of("exchange/data_dark", unwritten((2**36, 4, 5))), "data_dark: is uint16"),
        (in_place_of("exchange/data_dark", unwritten((2_000_000, 4, 5), chunks=(1, 4, 5))), "has 2000000 frames"),
        (in_place_of("exchange/data_white", unwritten((2**50, 4, 5), chunks=(1, 4, 5))), "data_white: is uint16"),
        (in_place_of("exchange/data_dark", one_chunk_of_gigabytes), "bytes packed in a chunk of 40 bytes"),
        (in_place_of("exchange/theta", unwritten((2**29,), "f8", chunks=(1024,))), "theta: is float64 of shape"),
        (in_place_of("exchange/theta", unwritten((2**24,), "f8", chunks=(1024,))), "16777216 angles for 6 frames"),
        (in_place_of("exchange/theta", unwritten((2**60,), "f8", chunks=(1024,))), "theta: is float64 of shape"),
        (in_place_of("exchange/time", unwritten((2**29, 1), "f8", chunks=(1024, 1))), "time: is float64 of shape"),
        (in_place_of("exchange/data", of_large_frames(unwritten((6, 2**14, 2**14)))), "data: is uint16 of shape"),
        (in_place_of("exchange/data", of_large_frames(packed_zeros((6, 2**14, 2**14), (1, 2**14, 2**14)))), "at most"),
        (in_place_of("exchange/data", of_large_frames(unwritten((2**40, 1, 1), "u1", chunks=(1, 1, 1)))), "is uint8"),
        (in_place_of("exchange/data", unwritten((6, 20_000, 20_000), chunks=(6, 20_000, 20_000))), "is uint16"),
        (in_place_of("exchange/theta", lambda file, name: file.create_dataset(name, data=np.full(6, 1e99))), "angle 0"),
        (in_place_of("exchange/time", lambda file, name: file.create_dataset(name, data=np.full(6, np.nan))), "time 0"),
        (in_place_of("exchange/theta", lambda file, name: file.create_group(name)), "no dataset /exchange/theta"),
        (in_place_of("exchange/data", lambda file, name: file.create_dataset(name, data="frames")), "has the shape"),
    ],
)
def test_sizes_that_are_only_stated_are_refused(recording: Path, harm: Callable[[Path], None], told: str) -> None:
    harm(recording)
    assert told in refused(read_frames, recording)


@pytest.mark.parametrize(
    "settings", ["[" * 100_000, "[1]", '{"binning": NaN}', '{"binning": ' + "9" * 5000 + "}", "{", 3, np.zeros(5000)]
)
def test_settings_that_are_no_settings_are_refused(recording: Path, settings: object) -> None:
    with h5py.File(recording, "r+") as file:
        file["process"].attrs["settings"] = settings
    assert "/process" in refused(read_frames, recording)


def test_a_pipe_is_refused_and_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "frames.h5")
    assert "is a pipe" in refused(read_frames, tmp_path / "frames.h5")
    assert "is a pipe" in refused(read_plan, tmp_path / "frames.h5")
    assert "is a device" in refused(read_frames, "/dev/zero")


@pytest.fixture
def elsewhere(tmp_path: Path) -> Path:
    """A file that is none of the recording's business, in another folder."""
    (tmp_path / "home").mkdir()
    path = tmp_path / "home" / "private.h5"
    with h5py.File(path, "w") as file:
        file["data"] = COUNTS
        file["exchange/data"] = COUNTS
    return path


def test_links_to_other_files_are_not_followed(recording: Path, elsewhere: Path) -> None:
    for name, link in {
        "exchange/data": h5py.ExternalLink(elsewhere, "data"),
        "exchange/data_dark": h5py.SoftLink("/there/data"),
        "there": h5py.ExternalLink(elsewhere, "/"),
    }.items():
        with h5py.File(recording, "r+") as file:
            if name in file:
                del file[name]
            file[name] = link
    assert "/exchange/data: is a link to another file" in refused(read_frames, recording)
    with h5py.File(recording, "r+") as file:
        del file["exchange/data"]
        file["exchange/data"] = COUNTS
    assert "/exchange/data_dark: is a link to another file" in refused(read_frames, recording)


def test_links_in_circles_are_left(recording: Path) -> None:
    with h5py.File(recording, "r+") as file:
        del file["exchange/data"]
        file["exchange/data"] = h5py.SoftLink("/exchange/data")
    assert "is a link" in refused(read_frames, recording)


def test_links_within_the_file_are_followed(recording: Path) -> None:
    with h5py.File(recording, "r+") as file:
        file["entry/images"] = file["exchange/data"]
        del file["exchange/data"]
        file["exchange/data"] = h5py.SoftLink("/entry/images")
    with open_frames(recording) as frames:
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS)


def test_raw_data_in_another_file_are_not_read(recording: Path, elsewhere: Path) -> None:
    def make(file: h5py.File, name: str) -> None:
        file.create_dataset(name, COUNTS.shape, "u2", external=[(str(elsewhere), 0, COUNTS.nbytes)])

    in_place_of("exchange/data", make)(recording)
    assert "has its data in another file" in refused(read_frames, recording)


def virtual(recording: Path, source: str, name: str = "data") -> None:
    layout = h5py.VirtualLayout(COUNTS.shape, "u2")
    layout[:] = h5py.VirtualSource(source, name, COUNTS.shape)
    with h5py.File(recording, "r+") as file:
        del file["exchange/data"]
        file.create_virtual_dataset("exchange/data", layout)


def test_a_virtual_recording_is_read_from_its_own_folder_alone(recording: Path, elsewhere: Path) -> None:
    virtual(recording, str(elsewhere))
    assert "leads out of its folder" in refused(read_frames, recording)
    virtual(recording, "../home/private.h5")
    assert "leads out of its folder" in refused(read_frames, recording)
    shutil.copy(elsewhere, recording.parent / "scan.h5")
    virtual(recording, "scan.h5")
    with open_frames(recording) as frames:
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS)
    (recording.parent / "part.h5").symlink_to("/etc/hostname")
    virtual(recording, "part.h5")
    assert "leads out of its folder" in refused(read_frames, recording)
    virtual(recording, "absent.h5")
    assert "put together from absent.h5, which cannot be read" in refused(read_frames, recording)
    os.mkfifo(recording.parent / "pipe.h5")
    virtual(recording, "pipe.h5")
    assert "is a pipe" in refused(read_frames, recording)


def test_a_virtual_recording_of_itself_is_refused(recording: Path) -> None:
    virtual(recording, ".", "/exchange/data")
    assert "/exchange/data" in refused(read_frames, recording)
    virtual(recording, "frames.h5", "/exchange/data")
    assert "from itself" in refused(read_frames, recording)


def test_a_virtual_source_states_no_more_than_it_holds(recording: Path) -> None:
    with h5py.File(recording.parent / "part.h5", "w") as file:
        file.create_dataset("data", (2**40, 4, 5), "u2", chunks=(1, 4, 5))
    virtual(recording, "part.h5")
    assert "is uint16 of shape (1099511627776, 4, 5)" in refused(read_frames, recording)


def test_a_block_that_memory_cannot_hold_is_refused_before_it_is_taken(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("vialight.system.memory.psutil.virtual_memory", lambda: type("M", (), {"available": 0}))
    with open_frames(recording) as frames:
        assert len(frames.read(slice(None))) == 6  # so little is never asked for
    monkeypatch.setattr("vialight.system.memory.SMALL_BYTES", 0)
    with open_frames(recording) as frames, pytest.raises(InputError, match="GB of memory, and 0 GB are free"):
        frames.read(slice(None))


@pytest.fixture
def plan(tmp_path: Path) -> Path:
    grid = Grid((4, 6, 6), 0.1)
    corner = Mesh(np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 2, 1], [0, 1, 3]]))
    patterns = Patterns(np.ones((8, 3, 4), np.uint8), np.arange(8) * np.pi / 4, 0, 0, 0.1)
    write_plan(tmp_path / "plan.h5", Plan(patterns, corner, np.ones(grid.shape, np.float32), grid, Rig()))
    return tmp_path / "plan.h5"


@pytest.mark.parametrize(
    ("harm", "told"),
    [
        (in_place_of("patterns", unwritten((2**40, 3, 4), "u1", chunks=(1, 3, 4))), "/patterns: is uint8 of shape"),
        (in_place_of("target", unwritten((4, 2**20, 2**20), "f4")), "/target: is float32 of shape"),
        (in_place_of("angles_deg", unwritten((2**60,), "f8", chunks=(9,))), "/angles_deg: is float64 of shape"),
        (in_place_of("reference/faces", unwritten((2**40, 3), "i8", chunks=(9, 3))), "/reference/faces: is int64"),
        (in_place_of("patterns", packed_zeros((60, 2**12, 2**15), (1, 2**12, 2**15), "u1")), "bytes are stored"),
        (in_place_of("rig", lambda file, name: file.create_dataset(name, data="a" + ".a" * 40_000 + " = 1")), "levels"),
        (in_place_of("rig", unwritten((2**40,), "S1", chunks=(9,))), "rig: is |S1 of shape"),
        (in_place_of("rig", lambda file, name: file.create_dataset(name, (), "S100000000")), "/rig is no text"),
        (in_place_of("settings", lambda file, name: file.create_dataset(name, data="[" * 100_000)), "recursion"),
        (in_place_of("metrics", lambda file, name: file.create_dataset(name, data='{"a": NaN}')), "is not JSON"),
        (in_place_of("inputs", lambda file, name: file.create_dataset(name, data="[]")), "holds a list"),
        (in_place_of("schema", unwritten((2**60,), "i8", chunks=(9,))), "/schema: is int64 of shape"),
    ],
)
def test_a_plan_that_states_what_is_not_there_is_refused(plan: Path, harm: Callable[[Path], None], told: str) -> None:
    harm(plan)
    assert told in refused(read_plan, plan)


def test_a_plan_from_elsewhere_names_no_other_file(plan: Path, elsewhere: Path) -> None:
    in_place_of("rig", lambda file, name: file.__setitem__(name, h5py.ExternalLink(elsewhere, "data")))(plan)
    with pytest.raises(InputError, match="/rig: is a link to another file"):
        read_plan(plan)


@pytest.mark.parametrize(
    ("name", "of", "value"),
    [
        ("voxel_mm", "target", np.nan),
        ("voxel_mm", "target", 0.0),
        ("voxel_mm", "target", "wide"),
        ("first_row", "patterns", np.inf),
        ("dose_rate_per_level", "patterns", -1.0),
        ("dose_rate_per_level", "patterns", np.zeros(7000)),
    ],
)
def test_numbers_of_a_plan_that_mean_nothing_are_refused(plan: Path, name: str, of: str, value: object) -> None:
    with h5py.File(plan, "r+") as file:
        file[of].attrs[name] = value
    with pytest.raises(InputError, match=r"plan\.h5"):
        read_plan(plan)
