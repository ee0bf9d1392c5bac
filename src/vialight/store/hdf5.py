"""What is read of an HDF5 file that anyone may have made: its own content, of which the sizes are known first.

HDF5 can name other files in four ways: external links, links that lead over one, raw data kept elsewhere, and virtual
datasets.  Only the last is in use among recordings, and is read where its sources lie beside the recording.
h5py is imported when something is looked for.
"""

from __future__ import annotations

import math
from collections import deque
from pathlib import Path
from typing import Any

from vialight.core.errors import InputError
from vialight.system import check_plain, file_in

_MOST_LINKS = 32
_MOST_CHUNK_BYTES = 512 * 2**20
"""Of a chunk, which is unpacked whole for any part of it."""
_HARMLESS_BYTES = 256 * 2**20
"""That a dataset may state beyond what is stored, as one does that is still to be filled."""
_MOST_PACKED = 1100
"""Times that deflate packs what is all the same; no camera's frames come near."""
_BOUNDED_FILTERS = {2, 3, 32001}
"""Shuffle, checksum, blosc."""
_LEAST_CHUNK_BYTES = 65_536
_MOST_ATTRIBUTE_BYTES = 1_000_000
_MOST_LISTED = 8
_OWN_FILE = "."


def object_in(path: Path, file: Any, name: str) -> Any:
    """Return a group or dataset of a file, or None where there is none; whatever lies in another file is refused.

    Parameters
    ----------
    path
        Named in errors.
    file
        Open in h5py.
    name
        From the file's root, parts between slashes.

    Raises
    ------
    InputError
        A link on the way leads to another file, or round in circles.
    """
    import h5py

    found, parts, links = file, deque(name.split("/")), 0
    while parts:
        part = parts.popleft()
        if part in ("", "."):
            continue
        link = found.get(part, getlink=True) if isinstance(found, h5py.Group) else None
        if link is None:
            return None
        if isinstance(link, h5py.HardLink):
            found = found[part]
            continue
        links += 1
        if not isinstance(link, h5py.SoftLink) or links > _MOST_LINKS:
            raise InputError(
                f"{path} /{name}",
                "is a link to another file, or one that leads nowhere",
                accepted="data in the file itself",
                remedy="copy it into one file with h5repack or h5copy",
            )
        found = file if link.path.startswith("/") else found
        parts.extendleft(reversed(link.path.split("/")))
    return found


def dataset_in(
    path: Path, file: Any, name: str, *, may_be_virtual: bool = False, most_packed: int = _MOST_PACKED
) -> Any:
    """Return a dataset of a file, or None where there is none, with all its data where it can be read safely.

    Parameters
    ----------
    path, file, name
        As for `object_in`.
    may_be_virtual
        Whether its data may lie in other files, plain ones in the folder of `path`.
    most_packed
        Times that it may state what is stored.

    Raises
    ------
    InputError
        Its data lie elsewhere, or it states far more than is stored.
    """
    import h5py

    found = object_in(path, file, name)
    if not isinstance(found, h5py.Dataset) or found.shape is None:
        return None
    where = f"{path} /{name}"
    if found.external:
        raise _elsewhere(where, "has its data in another file")
    stored_bytes = found.id.get_storage_size()
    if found.is_virtual:
        if not may_be_virtual:
            raise _elsewhere(where, "is put together from other datasets")
        stored_bytes = sum(_source_bytes(path, file, where, *source) for source in _sources(found))
    stated_bytes = math.prod(found.shape) * found.dtype.itemsize
    if stated_bytes > max(_HARMLESS_BYTES, most_packed * stored_bytes):
        raise InputError(
            where,
            f"is {found.dtype} of shape {found.shape}, {stated_bytes / 1e9:.4g} GB, of which {stored_bytes} bytes "
            "are stored",
            accepted="data that are there",
            remedy="copy it again, or record again",
        )
    chunk_bytes = math.prod(found.chunks or ()) * found.dtype.itemsize
    if found.chunks and chunk_bytes > _MOST_CHUNK_BYTES:
        raise InputError(
            where,
            f"comes in pieces of {chunk_bytes / 1e9:.4g} GB",
            accepted=f"chunks of {_MOST_CHUNK_BYTES / 1e9:.2g} GB at most",
            remedy="rewrite it with h5repack, one frame a chunk",
        )
    if found.chunks and _unbounded_filters(found):
        _check_chunks(where, found, chunk_bytes)
    return found


def _unbounded_filters(dataset: Any) -> bool:
    """Tell whether a filter unpacks without asking how large a chunk is; blosc, which vialight uses, states it."""
    plist = dataset.id.get_create_plist()
    return any(plist.get_filter(index)[0] not in _BOUNDED_FILTERS for index in range(plist.get_nfilters()))


def _check_chunks(where: str, dataset: Any, chunk_bytes: int) -> None:
    """Refuse chunks that have more bytes packed than unpacked: what they unpack to has no bound."""
    most_bytes = _LEAST_CHUNK_BYTES + 1.1 * chunk_bytes
    larger = dataset.id.chunk_iter(lambda chunk: chunk.size if chunk.size > most_bytes else None)
    if larger is not None:
        raise InputError(
            where,
            f"has {larger} bytes packed in a chunk of {chunk_bytes} bytes",
            accepted="chunks that packing makes smaller",
            remedy="copy it again, or record again",
        )


def attribute(path: Path, of: Any, name: str) -> Any:
    """Return an attribute of a group or dataset, None where it has none; `InputError` where it is no single value."""
    import h5py

    if name not in of.attrs:
        return None
    held = h5py.h5a.open(of.id, name.encode())
    count, one_bytes = held.get_space().get_simple_extent_npoints(), held.get_type().get_size()
    if count > 1 or one_bytes > _MOST_ATTRIBUTE_BYTES:
        raise InputError(
            f"{path} {of.name}", f"its attribute {name} holds {count} values of {one_bytes} bytes", accepted="one value"
        )
    return of.attrs[name]


def dataset_names(file: Any) -> list[str]:
    """Return the names of a few datasets that a file holds, for an error."""
    import h5py

    names: list[str] = []
    waiting = deque([("", file)])
    while waiting and len(names) <= _MOST_LISTED:
        above, group = waiting.popleft()
        for _, key in zip(range(100), group, strict=False):
            if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                continue
            found = group[key]
            if isinstance(found, h5py.Dataset):
                names.append(f"{above}/{key}")
            elif isinstance(found, h5py.Group) and above.count("/") < 3:
                waiting.append((f"{above}/{key}", found))
    return names


def _sources(virtual: Any) -> set[tuple[str, str]]:
    return {(source.file_name, source.dset_name) for source in virtual.virtual_sources()}


def _source_bytes(path: Path, file: Any, where: str, source_file: str, source_name: str) -> int:
    """Return the bytes that a source of a virtual dataset has, checked as if it were read by itself."""
    import h5py

    if source_file == _OWN_FILE:
        found = dataset_in(path, file, source_name)
        return 0 if found is None else int(found.id.get_storage_size())
    if "%" in source_file or "%" in source_name:
        raise _elsewhere(where, f"is put together from files by a pattern ({source_file})")
    beside = file_in(path.parent, source_file)
    if beside.resolve() == path.resolve():
        raise _elsewhere(where, "is put together from itself")
    try:
        check_plain(beside)
        with h5py.File(beside, "r") as other:
            found = dataset_in(beside, other, source_name)
            if found is None:
                raise InputError(beside, f"holds no dataset {source_name}", remedy="copy the recording again")
            return int(found.id.get_storage_size())
    except OSError as error:
        raise InputError(
            where,
            f"is put together from {source_file}, which cannot be read ({error})",
            accepted="files in its own folder",
            remedy="copy them, too",
        ) from error


def _elsewhere(where: str, what: str) -> InputError:
    return InputError(
        where, what, accepted="data in the file itself", remedy="copy it into one file with h5repack or h5copy"
    )
