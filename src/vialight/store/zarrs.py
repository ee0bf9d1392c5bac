"""What is believed of a zarr folder that anyone may have made: vialight's own layout, with all its files in the folder.

The metadata of zarr name codecs, sizes and places, and every packed piece states what it unpacks to.  All of it is held
against the files before zarr is asked for anything.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from vialight.core.arrays import Float32Array
from vialight.core.errors import InputError
from vialight.store.results import read_json
from vialight.system import file_in, need_memory, open_plain

ARRAY = "0"
_VALUE_BYTES = 4
_LONGEST_EDGE = 2**16
_MOST_SHARDS = 20_000
_MOST_SHARD_BYTES = 1 << 40
_MOST_PACKED = 260
"""Times that blosc packs what is all the same."""
_HARMLESS_BYTES = 64_000_000
_NOT_THERE = 2**64 - 1
_CHECKSUM_BYTES = 4
_BLOSC = struct.Struct("<4B3I")
_BYTES = {"name": "bytes", "configuration": {"endian": "little"}}


class StoredImage(NamedTuple):
    """An image as its metadata have it."""

    path: Path
    attributes: dict[str, Any]
    shape: tuple[int, ...]
    shard: tuple[int, ...]
    """Shape of what is one file."""
    chunk: tuple[int, ...]
    """Shape of what is packed together in it."""
    separator: str


def attributes_of(path: Path) -> dict[str, Any]:
    """Return the attributes of a zarr's group; `InputError` where they are damaged, or in a file elsewhere."""
    return dict(_metadata(path, "zarr.json").get("attributes", {}))


def stored_image(path: Path, axes: int) -> StoredImage:
    """Return what the metadata of an image say, where they are such as vialight writes.

    Parameters
    ----------
    path
        The zarr folder.
    axes
        That the image has to have: 3, or 4 with time.

    Raises
    ------
    InputError
        It is packed otherwise, or a file of it lies elsewhere.
    ValueError, KeyError, TypeError
        The metadata are damaged.
    """
    attributes = attributes_of(path)
    found = _metadata(path, ARRAY, "zarr.json")
    if len(found["shape"]) != axes:
        wanted = "of three axes" if axes == 3 else "over time"
        raise InputError(path, f"is not an image {wanted}", accepted="an image that vialight wrote")
    (sharding,) = found["codecs"]
    inner = sharding["configuration"]
    keys = found["chunk_key_encoding"]
    separator = keys.get("configuration", {}).get("separator", "/")
    is_known = (
        (found["zarr_format"], found["node_type"], found["data_type"]) == (3, "array", "float32")
        and not found.get("storage_transformers")
        and (sharding["name"], inner["index_location"]) == ("sharding_indexed", "end")
        and [codec["name"] for codec in inner["codecs"]] == ["bytes", "blosc"]
        and inner["codecs"][0] == _BYTES
        and inner["index_codecs"] == [_BYTES, {"name": "crc32c"}]
        and found["chunk_grid"]["name"] == "regular"
        and keys["name"] == "default"
        and separator in ("/", ".")
    )
    if not is_known:
        raise InputError(path, "is packed otherwise than vialight does", accepted="shards of float32, by blosc")
    edges = found["shape"], found["chunk_grid"]["configuration"]["chunk_shape"], inner["chunk_shape"]
    shape, shard, chunk = (tuple(int(edge) for edge in one) for one in edges)
    if not len(shape) == len(shard) == len(chunk) or min(shape) < 0 or min(shard) < 1 or min(chunk) < 1:
        raise ValueError(f"shape {shape}, shards of {shard}, chunks of {chunk}")
    if max(shape[-3:]) > _LONGEST_EDGE:
        raise InputError(path, f"states {shape} voxels", accepted=f"{_LONGEST_EDGE} along an edge at most")
    return StoredImage(path, attributes, shape, shard, chunk, separator)


def read_stored(image: StoredImage, first: int | None = None) -> Float32Array:
    """Read an image whole, or its part at one index of its first axis, once its files are found to hold it.

    Parameters
    ----------
    image
        Of `stored_image`.
    first
        Index along the first axis, of shards that are 1 long there.

    Raises
    ------
    InputError
        A file is missing or lies elsewhere, or holds less than is stated, or memory cannot hold the image.
    ValueError
        A file is damaged.
    """
    import zarr

    shape = image.shape if first is None else image.shape[1:]
    stated_bytes = _VALUE_BYTES * math.prod(shape)
    stored_bytes, missing = 0, 0
    for path in _shards(image, first):
        if path.is_file():
            stored_bytes += _check_shard(path, image)
        else:
            missing += 1
    if missing:
        raise InputError(image.path, f"{missing} shards are missing", accepted="all of them", remedy="copy it again")
    if stated_bytes > _HARMLESS_BYTES + _MOST_PACKED * stored_bytes:
        raise InputError(
            image.path,
            f"states {stated_bytes / 1e9:.4g} GB, of which {stored_bytes} bytes are stored",
            accepted="voxels that are there",
            remedy="copy it again",
        )
    need_memory(1.2 * stated_bytes, image.path, f"a volume of {shape} voxels", "reconstruct with a coarser --voxel")
    array: Any = zarr.open_array(image.path / ARRAY, mode="r", zarr_format=3)
    return np.asarray(array[:] if first is None else array[first], dtype=np.float32)


def _metadata(path: Path, *names: str) -> dict[str, Any]:
    try:
        return read_json(file_in(path, *names))
    except InputError as error:
        raise InputError(
            path, f"is damaged ({error})", accepted="an image of vialight", remedy="copy or make it again"
        ) from error


def _shards(image: StoredImage, first: int | None) -> Iterator[Path]:
    """Yield where the files of an image are to be, none of them elsewhere."""
    counts = [-(-edge // of) for edge, of in zip(image.shape, image.shard, strict=True)]
    begins = [0] * len(counts)
    if first is not None:
        if image.shard[0] != 1:
            raise ValueError(f"shards of {image.shard}")
        begins[0], counts[0] = first, 1
    if math.prod(counts) > _MOST_SHARDS:
        raise InputError(image.path, f"states {math.prod(counts)} files", accepted=f"{_MOST_SHARDS} at most")
    for index in np.ndindex(*counts):
        yield file_in(image.path, ARRAY, *_key(index, begins, image.separator))


def _key(index: Sequence[int], begins: Sequence[int], separator: str) -> list[str]:
    return separator.join(["c", *(str(at + begin) for at, begin in zip(index, begins, strict=True))]).split("/")


def _check_shard(path: Path, image: StoredImage) -> int:
    """Check that every piece of a file is within it and unpacks to a chunk; return the file's size in bytes."""
    chunk_bytes = _VALUE_BYTES * math.prod(image.chunk)
    count = math.prod(-(-edge // of) for edge, of in zip(image.shard, image.chunk, strict=True))
    with open_plain(path, _MOST_SHARD_BYTES) as file:
        size = file.seek(0, 2)
        index_bytes = 16 * count + _CHECKSUM_BYTES
        if index_bytes > size:
            raise ValueError(f"{path.name} has {size} bytes, its index {index_bytes}")
        file.seek(size - index_bytes)
        index = np.frombuffer(file.read(16 * count), "<u8").reshape(-1, 2)
        for begin, length in index.tolist():
            if begin == length == _NOT_THERE:
                continue
            if begin + length > size or length < _BLOSC.size:
                raise ValueError(f"{path.name} is shorter than its index says")
            file.seek(begin)
            *_, unpacked_bytes, _, packed_bytes = _BLOSC.unpack(file.read(_BLOSC.size))
            if unpacked_bytes != chunk_bytes or packed_bytes != length:
                raise ValueError(f"a piece of {path.name} would unpack to {unpacked_bytes} bytes, not {chunk_bytes}")
    return size
