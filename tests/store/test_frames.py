from __future__ import annotations

import shutil
import subprocess
import sys
import textwrap
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vialight.core.errors import InputError
from vialight.store import FrameWriter, open_frames, write_frames

COUNTS = np.arange(6 * 4 * 5, dtype=np.uint16).reshape(6, 4, 5)
ANGLES_DEG = np.array([0.0, 60.5, 120.0, 300.0, 380.0, 355.0])


def make_exchange(path: Path, **changes: Any) -> Path:
    """Write a Data Exchange file by h5py alone; a change to None leaves the dataset out."""
    datasets = {"data": COUNTS, "theta": ANGLES_DEG} | changes
    with h5py.File(path, "w") as file:
        file["implements"] = "exchange"
        for name, value in datasets.items():
            if value is not None:
                file[f"exchange/{name}"] = value
    return path


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        open_frames(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)
    return str(caught.value)


def run_python(code: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-c", textwrap.dedent(code), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)


def test_frames_of_another_program_are_read_as_they_are(tmp_path: Path) -> None:
    dark = np.stack([np.full((4, 5), 7), np.full((4, 5), 10)]).astype(np.uint16)
    with open_frames(make_exchange(tmp_path / "f.h5", data_dark=dark)) as frames:
        assert frames.shape == (6, 4, 5)
        assert frames.dtype == np.uint16
        np.testing.assert_array_equal(frames.angles_rad, np.deg2rad(ANGLES_DEG))
        assert frames.time_s is None
        assert not frames.is_transmission
        assert frames.white() is None
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS)
        np.testing.assert_array_equal(frames.dark(slice(1, 3)), np.full((2, 5), 8.5))


@pytest.mark.parametrize("implements", ["exchange:measurement", b"exchange", np.array([b"exchange", b"process"]), None])
def test_implements_may_be_written_in_any_way(tmp_path: Path, implements: Any) -> None:
    path = make_exchange(tmp_path / "f.h5")
    with h5py.File(path, "r+") as file:
        del file["implements"]
        if implements is not None:
            file["implements"] = implements
    with open_frames(path) as frames:
        assert frames.shape == COUNTS.shape


def test_white_frames_make_it_transmission_data(tmp_path: Path) -> None:
    floats = COUNTS.astype(">f4")
    with open_frames(make_exchange(tmp_path / "f.h5", data=floats, data_white=floats[:2])) as frames:
        assert frames.is_transmission
        assert frames.dtype == np.dtype(np.float32)
        assert frames.dtype.isnative
        np.testing.assert_array_equal(frames.white(slice(0, 1)), COUNTS[:2, :1].mean(axis=0))
        np.testing.assert_array_equal(frames.read(slice(2, 3)), COUNTS[2:3])


def test_empty_dark_and_white_count_as_absent(tmp_path: Path) -> None:
    empty = np.zeros((0, 4, 5), np.uint16)
    with open_frames(make_exchange(tmp_path / "f.h5", data_dark=empty, data_white=empty)) as frames:
        assert frames.dark() is None
        assert not frames.is_transmission


@pytest.mark.parametrize(
    ("units", "factor"),
    [("deg", np.pi / 180), (b"Degrees ", np.pi / 180), ("rad", 1.0), (np.array(["radians"], "S"), 1)],
)
def test_unit_of_theta_is_obeyed(tmp_path: Path, units: Any, factor: float) -> None:
    path = make_exchange(tmp_path / "f.h5")
    with h5py.File(path, "r+") as file:
        file["exchange/theta"].attrs["units"] = units
    with open_frames(path) as frames:
        np.testing.assert_allclose(frames.angles_rad, ANGLES_DEG * factor, rtol=1e-15)


def test_unknown_unit_of_theta_is_refused_not_guessed(tmp_path: Path) -> None:
    path = make_exchange(tmp_path / "f.h5")
    with h5py.File(path, "r+") as file:
        file["exchange/theta"].attrs["units"] = "steps"
    assert "'steps'" in refusal(path)


def test_times_are_read_in_seconds(tmp_path: Path) -> None:
    path = make_exchange(tmp_path / "f.h5", time=np.arange(6.0))
    with h5py.File(path, "r+") as file:
        file["exchange/time"].attrs["units"] = "ms"
    with open_frames(path) as frames:
        assert frames.time_s is not None
        np.testing.assert_allclose(frames.time_s, np.arange(6) / 1000)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(indices=st.lists(st.integers(-6, 5), max_size=9), first=st.integers(0, 4), last=st.integers(0, 4))
def test_any_block_equals_the_same_block_of_the_array(
    tmp_path: Path, indices: list[int], first: int, last: int
) -> None:
    path = tmp_path / "f.h5"
    if not path.exists():
        make_exchange(path)
    chosen = np.array(indices, dtype=np.int64)
    with open_frames(path) as frames:
        np.testing.assert_array_equal(frames.read(chosen, slice(first, last)), COUNTS[chosen, first:last])
        np.testing.assert_array_equal(frames.read(slice(last, None, 2)), COUNTS[last::2])


def test_a_mask_chooses_frames(tmp_path: Path) -> None:
    mask = np.array([True, False, True, True, False, False])
    with open_frames(make_exchange(tmp_path / "f.h5")) as frames:
        np.testing.assert_array_equal(frames.read(mask), COUNTS[mask])


def test_reading_a_block_does_not_load_the_file(tmp_path: Path) -> None:
    path = tmp_path / "big.h5"
    with h5py.File(path, "w") as file:
        file.create_dataset("exchange/data", (400, 500, 500), np.uint16, chunks=(1, 500, 500))  # 200 MB, all fill value
        file["exchange/theta"] = np.arange(400.0)
    code = """
        import resource, sys
        from vialight.store import open_frames
        with open_frames(sys.argv[1]) as frames:
            frames.read(slice(0, 2), slice(0, 10))
            before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
            frames.read(slice(None), slice(0, 10))
            print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    """
    done = run_python(code, path)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) < 20_000  # kB: the block has 4 MB


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "none.h5")


def test_a_folder_is_not_a_recording(tmp_path: Path) -> None:
    assert "is a folder" in refusal(tmp_path)


def test_other_reasons_are_given_in_the_words_of_the_system(tmp_path: Path) -> None:
    assert "cannot be opened (Not a directory)" in refusal(make_exchange(tmp_path / "f.h5") / "frames.h5")


@pytest.mark.parametrize("content", [b"", b"solid cube\n", b"\x00" * 5000])
def test_a_file_that_is_not_hdf5_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "f.h5"
    path.write_bytes(content)
    assert "is not HDF5" in refusal(path)


def test_without_data_the_datasets_that_exist_are_listed(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    with h5py.File(path, "w") as file:
        file["entry/images"] = COUNTS
    assert "no dataset /exchange/data; the file holds /entry/images;" in refusal(path)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"theta": None}, "no dataset /exchange/theta"),
        ({"data": COUNTS[0]}, "has the shape (4, 5)"),
        ({"data": COUNTS[:0], "theta": ANGLES_DEG[:0]}, "is empty, of shape (0, 4, 5)"),
        ({"data": COUNTS[:, :0]}, "is empty, of shape (6, 0, 5)"),
        ({"data": COUNTS.astype("S3")}, "holds |S3"),
        ({"theta": ANGLES_DEG[:5]}, "5 angles for 6 frames"),
        ({"theta": np.arange(7.0)}, "7 angles for 6 frames"),
        ({"theta": np.where(np.arange(6) == 4, np.nan, ANGLES_DEG)}, "angle 4 is nan"),
        ({"theta": np.where(np.arange(6) == 2, np.inf, ANGLES_DEG)}, "angle 2 is inf"),
        ({"theta": np.ones((3, 2))}, "is float64 of shape (3, 2)"),
        ({"theta": ANGLES_DEG.astype("S5")}, "is |S5 of shape (6,)"),
        ({"time": np.arange(5.0)}, "5 times for 6 frames"),
        ({"data_dark": COUNTS[:, :3]}, "data_dark: is uint16 of shape (6, 3, 5)"),
        ({"data_white": COUNTS[:, :, :3]}, "data_white: is uint16 of shape (6, 4, 3)"),
        ({"data_dark": COUNTS[0]}, "data_dark: is uint16 of shape (4, 5)"),
    ],
)
def test_datasets_that_do_not_fit_are_refused(tmp_path: Path, changes: dict[str, Any], complaint: str) -> None:
    assert complaint in refusal(make_exchange(tmp_path / "f.h5", **changes))


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    path = make_exchange(tmp_path / "f.h5", data=np.zeros((6, 400, 500), np.uint16))
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 2)
    assert "is damaged or cut off" in refusal(path)


def test_damage_in_the_middle_is_told_when_that_block_is_read(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    with h5py.File(path, "w") as file:
        data = file.create_dataset("exchange/data", data=COUNTS, chunks=(1, 4, 5), compression="gzip")
        file["exchange/theta"] = ANGLES_DEG
        chunk = data.id.get_chunk_info(3)
    with path.open("r+b") as raw:
        raw.seek(chunk.byte_offset)
        raw.write(b"\xff" * chunk.size)
    with open_frames(path) as frames:
        np.testing.assert_array_equal(frames.read(slice(0, 3)), COUNTS[:3])
        with pytest.raises(InputError, match=r"f\.h5 /exchange/data: is damaged or cut off"):
            frames.read(slice(None))


def test_a_filter_that_is_not_installed_is_named(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    with h5py.File(path, "w") as file:
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk((1, 4, 5))
        plist.set_filter(32_999, h5py.h5z.FLAG_OPTIONAL)
        group = file.create_group("exchange")
        space = h5py.h5s.create_simple(COUNTS.shape)
        data = h5py.h5d.create(group.id, b"data", h5py.h5t.STD_U16LE, space, plist)
        data.write_direct_chunk((0, 0, 0), b"compressed", 0)
        group["theta"] = ANGLES_DEG
    with open_frames(path) as frames, pytest.raises(InputError, match="filter 32999"):
        frames.read(slice(0, 1))


def test_values_that_are_not_finite_are_refused_with_their_frame(tmp_path: Path) -> None:
    floats = COUNTS.astype(np.float32)
    floats[4, 2, 2] = np.nan
    with open_frames(make_exchange(tmp_path / "f.h5", data=floats)) as frames:
        frames.read(slice(0, 4))
        with pytest.raises(InputError, match="frame 4 holds values that are not finite"):
            frames.read(np.array([5, 4, 0]))


def test_opening_a_plain_file_does_not_load_compression_plugins(tmp_path: Path) -> None:
    code = """
        import sys
        from vialight.store import open_frames
        loaded = {"h5py", "hdf5plugin", "zarr", "trimesh"} & set(sys.modules)
        open_frames(sys.argv[1]).close()
        print(loaded or "none", "hdf5plugin" in sys.modules)
    """
    done = run_python(code, make_exchange(tmp_path / "f.h5"))
    assert done.stdout.split() == ["none", "False"], done.stderr


def test_compressed_frames_are_read_by_a_fresh_process(tmp_path: Path) -> None:
    write_frames(tmp_path / "f.h5", COUNTS, np.deg2rad(ANGLES_DEG))
    code = """
        import sys
        from vialight.store import open_frames
        with open_frames(sys.argv[1]) as frames:
            print(int(frames.read(slice(None)).sum()))
    """
    done = run_python(code, tmp_path / "f.h5")
    assert done.stdout.split() == [str(COUNTS.sum())], done.stderr


WRITE_AND_WAIT = """
    import os, sys
    import numpy as np
    from vialight.store import FrameWriter
    writer = FrameWriter(sys.argv[1], (4, 5), dark=np.full((4, 5), 3, np.uint16))
    for index in range(3):
        writer.append(np.full((4, 5), index, np.uint16), angle_rad=index / 10, time_s=float(index))
    {before}
    print("ready", flush=True)
    {after}
"""


def read_while_another_process(path: Path, before: str, after: str, look: Callable[[], None]) -> None:
    code = textwrap.dedent(WRITE_AND_WAIT.format(before=before, after=after))
    with subprocess.Popen(
        [sys.executable, "-c", code, str(path)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
        try:
            look()
        finally:
            writer.communicate("go on\n", timeout=30)


def test_a_recording_is_readable_while_it_is_written(tmp_path: Path) -> None:
    def look() -> None:
        with open_frames(tmp_path / "f.h5") as frames:
            assert frames.is_live
            assert frames.shape == (3, 4, 5)
            np.testing.assert_allclose(frames.angles_rad, [0, 0.1, 0.2], rtol=1e-15)
            assert frames.time_s is not None
            np.testing.assert_array_equal(frames.read(slice(None))[:, 0, 0], [0, 1, 2])
            np.testing.assert_array_equal(frames.dark(), np.full((4, 5), 3))

    read_while_another_process(tmp_path / "f.h5", "", "sys.stdin.readline()", look)


def test_angles_may_be_ahead_of_frames_while_a_writer_lives_and_not_after(tmp_path: Path) -> None:
    def look() -> None:
        with open_frames(tmp_path / "f.h5") as frames:
            assert frames.shape[0] == frames.angles_rad.size == 3

    ahead = "writer._extend(writer._theta, 99.0)"
    read_while_another_process(tmp_path / "f.h5", ahead, "sys.stdin.readline(); writer._file.close()", look)
    assert "4 angles for 3 frames" in refusal(tmp_path / "f.h5")


def test_what_a_killed_writer_flushed_is_readable(tmp_path: Path) -> None:
    read_while_another_process(tmp_path / "f.h5", "", "sys.stdout.flush(); os.abort()", lambda: None)
    with open_frames(tmp_path / "f.h5") as frames:
        np.testing.assert_array_equal(frames.read(slice(None))[:, 0, 0], [0, 1, 2])


def test_a_file_locked_by_a_writer_that_does_not_share_is_refused(tmp_path: Path) -> None:
    code = """
        import sys, h5py
        file = h5py.File(sys.argv[1], "r+")
        print("ready", flush=True)
        sys.stdin.readline()
    """
    path = make_exchange(tmp_path / "f.h5")
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as writer:
        assert writer.stdout is not None
        assert writer.stdout.readline() == "ready\n"
        try:
            assert "is being written" in refusal(path)
        finally:
            writer.communicate("go on\n", timeout=30)


def test_written_frames_come_back(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    dark, times = np.full((3, 4, 5), 2, np.uint16), np.arange(6) / 10
    write_frames(path, COUNTS, np.deg2rad(ANGLES_DEG), dark=dark, time_s=times, settings={"exposure_s": 0.02})
    with open_frames(path) as frames:
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS)
        np.testing.assert_allclose(frames.angles_rad, np.deg2rad(ANGLES_DEG), rtol=1e-15)
        np.testing.assert_array_equal(frames.time_s, times)
        np.testing.assert_array_equal(frames.dark(), dark[0])
    with h5py.File(path) as file:
        assert file["implements"][()] == b"exchange"
        assert file["process"].attrs["settings"] == '{"exposure_s": 0.02}'
        assert file["exchange/data"].chunks == (1, 4, 5)
    assert [item.name for item in tmp_path.iterdir()] == ["f.h5"]


def test_write_frames_replaces_the_former_file_only_by_a_whole_one(tmp_path: Path) -> None:
    path = tmp_path / "f.h5"
    write_frames(path, COUNTS, np.deg2rad(ANGLES_DEG))
    former = path.read_bytes()
    with pytest.raises(InputError, match="unsigned integers"):
        write_frames(path, COUNTS.astype(np.int32), np.deg2rad(ANGLES_DEG))
    assert path.read_bytes() == former
    assert [item.name for item in tmp_path.iterdir()] == ["f.h5"]
    write_frames(path, COUNTS[:2], [0.0, 1.0])
    with open_frames(path) as frames:
        assert frames.shape == (2, 4, 5)


@pytest.mark.parametrize(
    ("changes", "complaint"),
    [
        ({"angles_rad": [0.0]}, r"angles_rad: has the shape \(1,\)"),
        ({"angles_rad": np.full(6, np.nan)}, "angles_rad: holds values that are not finite"),
        ({"time_s": np.zeros(4)}, r"time_s: has the shape \(4,\)"),
        ({"counts": COUNTS[0]}, r"counts: has the shape \(4, 5\)"),
        ({"dark": np.zeros((4, 4), np.uint16)}, r"dark: is uint16 of shape \(4, 4\)"),
    ],
)
def test_arrays_that_do_not_fit_are_not_written(tmp_path: Path, changes: dict[str, Any], complaint: str) -> None:
    arguments: dict[str, Any] = {"counts": COUNTS, "angles_rad": np.zeros(6)} | changes
    with pytest.raises(InputError, match=complaint):
        write_frames(tmp_path / "f.h5", **arguments)
    assert not list(tmp_path.iterdir())


def test_an_append_that_was_cut_short_leaves_a_consistent_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "f.h5"
    with FrameWriter(path, (4, 5)) as writer:
        writer.append(COUNTS[0], 0.0, 0.0)
        extend = writer._extend

        def interrupted(dataset: Any, value: Any) -> None:
            extend(dataset, value)
            raise KeyboardInterrupt

        monkeypatch.setattr(writer, "_extend", interrupted)
        with pytest.raises(KeyboardInterrupt):
            writer.append(COUNTS[1], 0.1, 0.1)
    with open_frames(path) as frames:
        assert not frames.is_live
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS[:1])


@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ((COUNTS[0].astype(np.uint8), 0.0, 0.0), "frame: is uint8"),
        ((COUNTS[0, :3], 0.0, 0.0), r"frame: is uint16 of shape \(3, 5\)"),
        ((COUNTS[:2], 0.0, 0.0), r"frame: has the shape \(2, 4, 5\)"),
        ((COUNTS[0], np.nan, 0.0), "angle_rad: is nan"),
        ((COUNTS[0], 0.0), "time_s: is None"),
    ],
)
def test_a_frame_that_does_not_fit_is_refused_and_the_recording_goes_on(
    tmp_path: Path, arguments: tuple[Any, ...], complaint: str
) -> None:
    with FrameWriter(tmp_path / "f.h5", (4, 5)) as writer:
        with pytest.raises(InputError, match=complaint):
            writer.append(*arguments)
        writer.append(COUNTS[1], 0.5, 0.0)
        assert writer.count == 1
    with open_frames(tmp_path / "f.h5") as frames:
        np.testing.assert_array_equal(frames.read(slice(None)), COUNTS[1:2])


def test_a_recording_is_never_overwritten(tmp_path: Path) -> None:
    path = make_exchange(tmp_path / "f.h5")
    former = path.read_bytes()
    with pytest.raises(InputError, match="exists already"):
        FrameWriter(path, (4, 5))
    assert path.read_bytes() == former


def test_a_recording_into_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"there is no folder .*nowhere"):
        FrameWriter(tmp_path / "nowhere" / "f.h5", (4, 5))


def test_settings_that_json_cannot_hold_leave_no_file(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Out of range float"):
        FrameWriter(tmp_path / "f.h5", (4, 5), settings={"gain_db": float("nan")})
    assert not list(tmp_path.iterdir())


def test_a_full_disk_ends_a_recording_with_its_frames_safe(small_disk: Path) -> None:
    code = """
        import sys
        import numpy as np
        from vialight.core.errors import InputError
        from vialight.store import FrameWriter, open_frames
        noise = np.random.default_rng(0).integers(0, 65536, (100, 200, 300), dtype=np.uint16)
        try:
            with FrameWriter(sys.argv[1], (200, 300)) as writer:
                for index, frame in enumerate(noise):
                    writer.append(frame, index / 10, index / 10)
        except InputError as error:
            print(error)
        with open_frames(sys.argv[1]) as frames:
            print(frames.shape[0] == writer.count > 3, (frames.read(slice(None)) == noise[: writer.count]).all())
    """
    done = run_python(code, small_disk / "f.h5")
    assert done.returncode == 0, done.stderr
    message, verdict = done.stdout.splitlines()
    assert "the disk is full" in message
    assert "frames are safe" in message
    assert verdict == "True True"


def test_a_full_disk_leaves_no_half_of_write_frames(small_disk: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 65536, (100, 200, 300), dtype=np.uint16)
    with pytest.raises(InputError, match=r"big\.h5: the disk is full \(\d+\.\d MB free\); nothing was left"):
        write_frames(small_disk / "big.h5", noise, np.arange(100.0))
    assert not list(small_disk.iterdir())


SHARED = Path(__file__).resolve().parents[3] / "shared" / "cases"


@pytest.mark.skipif(not SHARED.is_dir(), reason="the shared cases are not beside this checkout")
@pytest.mark.parametrize(
    ("case", "shape", "is_transmission"),
    [("part", (180, 120, 176), False), ("cylinder", (180, 120, 176), False), ("tooth", (181, 2, 640), True)],
)
def test_shared_cases_open(tmp_path: Path, case: str, shape: tuple[int, int, int], is_transmission: bool) -> None:
    path = shutil.copy(SHARED / case / "frames.h5", tmp_path)
    with open_frames(path) as frames:
        assert frames.shape == shape
        assert frames.is_transmission is is_transmission
        middle = slice(shape[1] // 2, shape[1] // 2 + 1)
        block = frames.read(slice(0, 4), middle)
        dark = frames.dark(middle)
        assert dark is not None
        assert block.mean() > dark.mean() > 0
