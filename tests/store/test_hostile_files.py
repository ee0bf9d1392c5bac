"""Small files of a run, and arrays, that are pipes, links, too deep, too large or not what they state."""

from __future__ import annotations

import io
import json
import os
import shutil
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from hostile import read_frames, refused
from vialight.core.arrays import Grid, Volume
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh
from vialight.store import (
    SavedState,
    VolumeSeriesWriter,
    list_history,
    list_surfaces,
    read_heights,
    read_history,
    read_json,
    read_projections,
    read_series,
    read_state,
    read_surface,
    read_table,
    read_volume,
    sha256_of,
    write_frames,
    write_ply,
    write_state,
    write_volume,
)
from vialight.store.hdf5 import dataset_names
from vialight.store.rig_files import load_rig, parse_toml
from vialight.system import file_in, need_memory, open_plain

HUGE = 2**40


@pytest.mark.parametrize(
    "content",
    [
        b"[" * 1_000_000,
        b'{"a":' * 100_000,
        b'{"a": ' + b"[" * 100 + b"]" * 100 + b"}",
        b'{"a": NaN}',
        b'{"a": Infinity}',
        b'{"a": 1e999}',
        b'{"a": ' + b"9" * 5000 + b"}",
        b'{"a": 9999999999999999999999}',
        b'{"a": "\\ud800"}',
        b"[]",
        b'"text"',
        b"{}" * 2,
        b"\xff\xfe{}",
        b"{" + b" " * 20_000_000 + b"}",
    ],
    ids=range(14),
)
def test_json_that_no_program_can_use_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "run.json"
    path.write_bytes(content)
    assert refused(read_json, path).startswith(str(path))


def test_json_with_a_mark_of_the_byte_order_is_read(tmp_path: Path) -> None:
    (tmp_path / "run.json").write_bytes(b'\xef\xbb\xbf{"name": "W\xc3\xbcrfel"}')
    assert read_json(tmp_path / "run.json") == {"name": "Würfel"}


@pytest.mark.parametrize(
    "content",
    [
        "a" + ".a" * 40_000 + " = 1",
        "a = " + "[" * 100_000,
        "a = " + "{b=" * 10_000,
        "[" + "a." * 30_000 + "a]",
        '"a,b"' + '."a,b"' * 10_000 + " = 1",
        "a = " + "9" * 5000,
        "a = " + "9" * 100,
        "a = 0x" + "f" * 1000,
        "stage.speed_deg_s = " + "9" * 18 + "999",
        "a = '" + "x" * 300_000 + "'",
        "resin.name = " + '"""' + '\\"""' * 50_000,
        "speed = '" + "x" * 100_000 + "'",
        'a = ["""a"""", {b' + ".a" * 100_000 + ' = "1"}]',
        "a = ['''a'''', {b" + ".a" * 100_000 + " = '1'}]",
    ],
    ids=range(14),
)
def test_toml_that_takes_for_ever_is_refused(tmp_path: Path, content: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(content)
    assert refused(load_rig, path).startswith(str(path))


@pytest.mark.parametrize("repeated", ['\\"""', '\\"', "\\'''", '"\n', "'\n", "a"])
@pytest.mark.parametrize("first", ["", '"', '"""', "'''", "'"])
def test_strings_without_an_end_are_told_at_once(first: str, repeated: str) -> None:
    content = "a = " + first + repeated * (250_000 // len(repeated))
    began = time.monotonic()
    with pytest.raises(InputError, match="is not TOML"):
        parse_toml(content, "rig.toml")
    assert time.monotonic() - began < 1.0


@pytest.mark.parametrize("text", ["a", 'a"', 'a""', '\\"""a', '""a', ""])
def test_strings_of_many_lines_may_end_with_quotes(text: str) -> None:
    assert parse_toml(f'a = """{text}"""\nb.c = "[[["', "rig.toml")["a"] == text.replace("\\", "")


def test_a_rig_saved_by_an_editor_that_marks_the_byte_order_is_read(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_bytes(b"\xef\xbb\xbf[stage]\r\nspeed_deg_s = 20.0\r\n")
    assert load_rig(tmp_path / "rig.toml").stage.speed_deg_s == 20


def read_two_columns(path: Path) -> None:
    read_table(path, ["a", "b"])


def read_stack(path: Path) -> None:
    read_projections(path, axes="angle,row,column", span_deg=360)


def read_with_angles(path: Path) -> None:
    stack = path.with_name("stack.npy")
    np.save(stack, np.zeros((4, 2, 2)))
    read_projections(stack, axes="angle,row,column", angles=path)


def read_osmo(path: Path) -> None:
    read_state(path, "osmo", (4, 5, 3), (5, 5, 3))


READERS: dict[str, Callable[[Path], Any]] = {
    "run.json": read_json,
    "rig.toml": load_rig,
    "table.csv": read_two_columns,
    "heights.npy": read_heights,
    "heights.csv": read_heights,
    "heights.tif": read_heights,
    "stack.npz": read_stack,
    "pages.tif": read_stack,
    "angles.txt": read_with_angles,
    "angles.npy": read_with_angles,
    "state.npz": read_osmo,
    "input": sha256_of,
}


@pytest.mark.parametrize("name", READERS)
def test_what_is_no_file_is_refused_and_not_waited_for(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / name)
    assert "is a pipe" in refused(READERS[name], tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to("/dev/zero")
    assert "is a device" in refused(READERS[name], tmp_path / name)
    (tmp_path / name).unlink()
    (tmp_path / name).symlink_to(name)
    with pytest.raises(InputError):
        READERS[name](tmp_path / name)


def header(shape: tuple[int, ...], dtype: str = "<f8") -> bytes:
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": dtype, "fortran_order": False, "shape": shape})
    return file.getvalue()


@pytest.mark.parametrize(
    "content",
    [
        header((HUGE, HUGE)),
        header((HUGE,)) + bytes(1000),
        header((2**63, 2)),
        header((-1, 16)),
        header((2**62,), "|S0"),
        header((20, 20), "|O") + b"cos\nsystem\n(S'true'\ntR.",
        b"\x93NUMPY\x02\x00\xff\xff\xff\xff",
        b"\x93NUMPY\x01\x00\xff\xff" + b"(" * 65535,
        b"\x93NUMPY\x09\x00",
        b"",
    ],
    ids=range(10),
)
def test_arrays_that_state_what_is_not_there_are_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "array.npy"
    path.write_bytes(content)
    assert refused(read_heights, path).startswith(str(path))
    assert refused(read_stack, path).startswith(str(path))
    with zipfile.ZipFile(tmp_path / "array.npz", "w") as archive:
        archive.writestr("stack.npy", content)
    assert "array.npz" in refused(read_stack, tmp_path / "array.npz")


def test_a_header_that_unpacks_to_much_more_than_an_array_has_is_not_read(tmp_path: Path) -> None:
    size = 300_000_000
    with (
        zipfile.ZipFile(tmp_path / "array.npz", "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
        archive.open("stack.npy", "w") as member,
    ):
        member.write(b"\x93NUMPY\x02\x00" + size.to_bytes(4, "little"))
        for _ in range(size // 1_000_000):
            member.write(b" " * 1_000_000)
    assert "NumPy's format (2, 0)" in refused(read_stack, tmp_path / "array.npz")


def moment(**changes: Any) -> dict[str, Any]:
    names = ("frames", "time_s", "lit_s", "cured_volume_mm3", "rmse_mm", "reverse_rmse_mm", "iou", "stop_s", "sigma_s")
    images = {f"{kind}_{plane}": np.zeros((3, 4)) for kind in ("density", "cured") for plane in ("xy", "xz", "yz")}
    return dict.fromkeys(names, 1.0) | {"voxel_mm": 0.1, "centre_z_mm": 0.0} | images | changes


def write_moment(run: Path, **changes: Any) -> Path:
    (run / "history").mkdir(exist_ok=True)
    np.savez_compressed(run / "history" / "000001.npz", allow_pickle=True, **moment(**changes))
    return run


def test_a_moment_that_unpacks_to_gigabytes_is_refused(tmp_path: Path) -> None:
    run = write_moment(tmp_path)
    with (
        zipfile.ZipFile(run / "history" / "000001.npz", "a", zipfile.ZIP_DEFLATED) as archive,
        archive.open("slice_xy.npy", "w") as member,
    ):
        member.write(header((1000, 125_000)))
        for _ in range(1000):
            member.write(bytes(1_000_000))
    assert "would unpack to" in refused(read_history, run, 1)


@pytest.mark.parametrize(
    "changes",
    [
        {"frames": np.array(None, dtype=object)},
        {"frames": np.nan},
        {"time_s": "now"},
        {"time_s": np.zeros(5)},
        {"voxel_mm": 0.0},
        {"voxel_mm": np.nan},
        {"centre_z_mm": np.inf},
        {"density_xy": np.zeros(4)},
        {"cured_yz": np.zeros((0, 4))},
        {"density_xz": np.array([["a", "b"]])},
    ],
    ids=range(10),
)
def test_a_moment_that_none_can_be_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="is damaged, or no moment"):
        read_history(write_moment(tmp_path, **changes), 1)
    assert read_history(write_moment(tmp_path), 1).voxel_mm == 0.1


def write_surface(run: Path) -> Path:
    (run / "surfaces").mkdir()
    write_ply(run / "surfaces" / "000001.ply", Mesh(np.eye(3), np.array([[0, 1, 2]])))
    return run / "surfaces" / "000001.ply"


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"element vertex 3", b"element vertex 9999999999999"),
        (b"element vertex 3", b"element vertex -1"),
        (b"element face 1", b"element face 99999999999999"),
        (b"\x02\x00\x00\x00", b"\xff\xff\xff\x7f"),
        (b"end_header\n", b"x" * 1_000_000),
        (b"\x00\x00\x80?", b"\x00\x00\xc0\x7f"),
    ],
    ids=range(6),
)
def test_a_surface_that_no_viewer_could_draw_is_refused(tmp_path: Path, old: bytes, new: bytes) -> None:
    path = write_surface(tmp_path)
    assert old in path.read_bytes()
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    assert refused(read_surface, tmp_path, 1).startswith(str(path))


def test_what_leads_out_of_a_run_is_not_read(tmp_path: Path) -> None:
    mine, gift = tmp_path / "mine", tmp_path / "gift"
    for folder in (mine, gift):
        folder.mkdir()
    write_moment(mine)
    write_surface(mine)
    (gift / "history").symlink_to(mine / "history")
    (gift / "surfaces").mkdir()
    (gift / "surfaces" / "000001.ply").symlink_to(mine / "surfaces" / "000001.ply")
    assert list_history(gift) == []
    assert list_surfaces(gift) == [1]
    for read in (read_history, read_surface):
        with pytest.raises(InputError, match="leads out of its folder"):
            read(gift, 1)
    for name in ("../mine/history", "/etc/passwd", "a\0b", "history/../../mine"):
        with pytest.raises(InputError, match="leads out of its folder"):
            file_in(gift, name)


def test_a_run_may_itself_be_reached_by_a_link_and_hold_links_that_stay_in_it(tmp_path: Path) -> None:
    run = tmp_path / "run"
    run.mkdir()
    write_surface(run)
    (run / "surfaces" / "000009.ply").symlink_to("000001.ply")
    (tmp_path / "newest").symlink_to(run)
    assert len(read_surface(tmp_path / "newest", 9).faces) == 1


def test_names_that_only_look_like_numbers_are_no_moments(tmp_path: Path) -> None:
    write_moment(tmp_path)
    for name in ("²²²²²²", "٠٠٠٠٠٢", "1", "9" * 200, "-00001"):
        (tmp_path / "history" / f"{name}.npz").touch()
    assert list_history(tmp_path) == [1]


def state(**changes: Any) -> SavedState:
    shapes = {"model": (5, 5, 3), "projections": (4, 5, 3), "dose": (5, 5, 3)}
    arrays = {name: np.ones(shape, np.float32) for name, shape in shapes.items()}
    held_values: dict[str, Any] = {"method": "osmo", "passes": 3} | arrays | changes
    return SavedState(**held_values)


@pytest.mark.parametrize(
    "changes",
    [
        {"model": np.ones((1, 1, 1), np.float32)},
        {"dose": np.full((5, 5, 3), np.nan)},
        {"passes": -1},
        {"model": np.ones((5, 5, 3), object)},
        {"method": "x" * 100_000},
        {"passes": np.ones(5)},
    ],
    ids=range(6),
)
def test_a_state_that_would_be_computed_with_out_of_bounds_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    write_state(tmp_path / "state.npz", state())
    assert read_state(tmp_path / "state.npz", "osmo", (4, 5, 3), (5, 5, 3)).passes == 3
    write_state(tmp_path / "state.npz", state(**changes))
    assert refused(read_osmo, tmp_path / "state.npz").startswith(str(tmp_path))


def test_pages_that_are_only_stated_are_refused(tmp_path: Path) -> None:
    page = Image.new("L", (6000, 6000))
    page.save(tmp_path / "pages.tif", save_all=True, append_images=[page] * 9, compression="tiff_adobe_deflate")
    assert "states 10 images" in refused(read_stack, tmp_path / "pages.tif")
    (tmp_path / "folder").mkdir()
    page.save(tmp_path / "folder" / "0.png")
    for number in range(1, 10):
        shutil.copy(tmp_path / "folder" / "0.png", tmp_path / "folder" / f"{number}.png")
    assert "states 10 images" in refused(read_stack, tmp_path / "folder")


def test_a_page_that_is_larger_than_the_first_is_not_decoded(tmp_path: Path) -> None:
    large = Image.new("F", (5000, 5000))
    small = Image.new("F", (4, 4))
    small.save(tmp_path / "pages.tif", save_all=True, append_images=[large], compression="tiff_adobe_deflate")
    told = refused(read_stack, tmp_path / "pages.tif")
    assert "page 0 is (4, 4), page 1 is (5000, 5000)" in told


def test_pages_are_counted_with_the_bytes_of_their_kind(tmp_path: Path) -> None:
    page = Image.new("F", (4000, 4000))
    page.save(tmp_path / "pages.tif", save_all=True, append_images=[page] * 9, compression="tiff_adobe_deflate")
    assert "states 10 images, 0.64 GB" in refused(read_stack, tmp_path / "pages.tif")


GRID = Grid((20, 6, 6), 0.1)


@pytest.fixture
def volume(tmp_path: Path) -> Path:
    path = tmp_path / "run" / "volume.zarr"
    path.parent.mkdir()
    write_volume(path, Volume(np.random.default_rng(0).normal(size=GRID.shape).astype(np.float32), GRID))
    return path


def edited(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    held = json.loads(path.read_text())
    change(held)
    path.write_text(json.dumps(held))


def sharding(held: dict[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = held["codecs"][0]["configuration"]
    return found


@pytest.mark.parametrize(
    "change",
    [
        lambda held: held.update(shape=[HUGE, 6, 6]),
        lambda held: held.update(shape=[20, 2**31, 2**31]),
        lambda held: (
            held.update(shape=[HUGE] * 3),
            held["chunk_grid"]["configuration"].update(chunk_shape=[HUGE] * 3),
        ),
        lambda held: held["chunk_grid"]["configuration"].update(chunk_shape=[1, 1, 1]),
        lambda held: sharding(held).update(chunk_shape=[16, 2**14, 2**14]),
        lambda held: sharding(held).update(chunk_shape=[0, 0, 0]),
        lambda held: sharding(held)["codecs"].append({"name": "numcodecs.pickle"}),
        lambda held: held.update(codecs=[{"name": "bytes", "configuration": {"endian": "little"}}]),
        lambda held: held.update(data_type="string"),
        lambda held: held.update(storage_transformers=[{"name": "x"}]),
        lambda held: held["chunk_key_encoding"].update(configuration={"separator": "/../../"}),
        lambda held: held.update(shape="wide"),
    ],
    ids=range(12),
)
def test_a_zarr_that_states_what_it_does_not_hold_is_refused(
    volume: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    edited(volume / "0" / "zarr.json", change)
    assert refused(read_volume, volume).startswith(str(volume))


@pytest.mark.parametrize(
    "change",
    [
        lambda held: held["attributes"].update(ome=[]),
        lambda held: held["attributes"]["vialight"].update(centre_z_mm="high"),
        lambda held: held["attributes"]["ome"]["multiscales"][0].update(axes=3),
        lambda held: held["attributes"]["ome"]["multiscales"][0]["datasets"][0]["coordinateTransformations"][0].update(
            scale=[0, 0, 0]
        ),
        lambda held: held.update(attributes=[1]),
        lambda held: held["attributes"].update(deep=json.loads("[" * 200 + "]" * 200)),
    ],
    ids=range(6),
)
def test_attributes_of_a_zarr_that_mean_nothing_are_refused(
    volume: Path, change: Callable[[dict[str, Any]], object]
) -> None:
    edited(volume / "zarr.json", change)
    assert refused(read_volume, volume).startswith(str(volume))


def test_metadata_beside_the_files_are_not_believed(volume: Path) -> None:
    stated = json.loads((volume / "0" / "zarr.json").read_text()) | {"shape": [20, 6, 7]}
    inline = {"kind": "inline", "must_understand": False, "metadata": {"0": stated}}
    edited(volume / "zarr.json", lambda held: held.update(consolidated_metadata=inline))
    assert read_volume(volume).density.shape == GRID.shape


def test_a_piece_that_states_gigabytes_is_refused(volume: Path) -> None:
    shard = volume / "0" / "c" / "0" / "0" / "0"
    content = bytearray(shard.read_bytes())
    content[4:8] = (2**31 - 1).to_bytes(4, "little")
    shard.write_bytes(content)
    assert "would unpack to 2147483647 bytes" in refused(read_volume, volume)


@pytest.mark.parametrize("name", ["zarr.json", "0", "0/zarr.json", "0/c", "0/c/0", "0/c/0/0/0"])
def test_no_part_of_a_zarr_may_lie_elsewhere(volume: Path, tmp_path: Path, name: str) -> None:
    (volume / name).rename(tmp_path / "elsewhere")
    (volume / name).symlink_to(tmp_path / "elsewhere")
    assert "leads out of its folder" in refused(read_volume, volume)
    (volume / name).unlink()
    os.mkfifo(volume / name)
    assert refused(read_volume, volume).startswith(str(volume))


def read_first(path: Path) -> None:
    read_series(path).volume(0)


def test_a_series_states_no_more_than_it_holds_and_nothing_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "run" / "volumes.zarr"
    path.parent.mkdir()
    VolumeSeriesWriter(path, GRID).append(np.ones(GRID.shape, np.float32), time_s=1.0)
    assert read_series(path).volume(0).density.max() == 1
    kept = shutil.copytree(path, tmp_path / "kept")
    edited(path / "zarr.json", lambda held: held["attributes"]["vialight"].update(moments={"time_s": [1.0] * 9}))
    with pytest.raises(InputError, match="volume 8 is missing"):
        read_series(path).volume(8)
    edited(path / "zarr.json", lambda held: held["attributes"]["vialight"].update(moments=[1]))
    assert "is damaged" in refused(read_series, path)
    shutil.rmtree(path)
    shutil.copytree(kept, path)
    edited(path / "0" / "zarr.json", lambda held: held.update(shape=[1, 20, 2**31, 2**31]))
    assert refused(read_first, path).startswith(str(path))
    shutil.rmtree(path)
    shutil.copytree(kept, path)
    shutil.rmtree(path / "0" / "c")
    (path / "0" / "c").symlink_to(kept / "0" / "c")
    assert "leads out of its folder" in refused(read_first, path)


def test_a_folder_that_is_hashed_names_nothing_elsewhere(tmp_path: Path) -> None:
    (tmp_path / "stack").mkdir()
    (tmp_path / "stack" / "a.png").symlink_to("/etc/hostname")
    with pytest.raises(InputError, match="leads out of its folder"):
        sha256_of(tmp_path / "stack")


def test_holes_are_refused_in_what_is_read_from_end_to_end_alone(tmp_path: Path) -> None:
    path = tmp_path / "frames.h5"
    write_frames(path, np.ones((4, 2, 3), np.uint16), np.arange(4.0), time_s=np.arange(4.0))
    with path.open("r+b") as file:
        file.truncate(3_000_000_000)
    read_frames(path)
    with pytest.raises(InputError, match="is all holes"):
        open_plain(path, HUGE)


def test_datasets_are_listed_without_walking_endless_groups(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "deep.h5", "w") as file:
        group = file
        for _ in range(500):
            group = group.create_group("g")
        file["last"] = np.zeros(3)
        assert dataset_names(file) == ["/last"]


def test_memory_is_asked_for_in_a_line_that_says_what_to_do() -> None:
    with pytest.raises(InputError, match=r"v\.zarr: a volume needs 1e\+09 GB .* are free; .*coarser --voxel"):
        need_memory(1e18, "v.zarr", "a volume", "choose a coarser --voxel")
