"""Bytes as a camera sends them to counts: the monochrome pixel formats of the GenICam naming convention."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vialight.devices.protocols import DeviceError

Bytes = NDArray[np.uint8]

_BITS = {
    "Mono8": 8, "Mono10": 10, "Mono10p": 10, "Mono12": 12, "Mono12p": 12, "Mono12Packed": 12, "Mono14": 14,
    "Mono16": 16,
}  # fmt: skip
_PACKED = {"Mono10p": 10, "Mono12p": 12, "Mono12Packed": 12}
"""Bits that a pixel takes; the others take whole bytes."""


def full_level(pixel_format: str) -> int:
    """Return the largest count of a format.

    Raises
    ------
    DeviceError
        It is none that is known.

    Examples
    --------
    >>> full_level("Mono12p")
    4095
    """
    if pixel_format not in _BITS:
        raise DeviceError("camera", f"sends {pixel_format}", f"set [camera.settings] pixel_format: {', '.join(_BITS)}")
    return int(2 ** _BITS[pixel_format] - 1)


def frame_bytes(pixel_format: str, columns: int, rows: int) -> int:
    """Return the bytes that an image takes, without padding at the ends of its rows.

    Examples
    --------
    >>> frame_bytes("Mono12p", 3, 1), frame_bytes("Mono16", 3, 1)
    (5, 6)
    """
    bits = _PACKED.get(pixel_format) or 8 * (1 + (full_level(pixel_format) > 255))
    return (columns * rows * bits + 7) // 8


def unpack(data: Bytes, pixel_format: str, columns: int, rows: int, padding: int = 0) -> NDArray[np.uint16]:
    """Return counts.

    Parameters
    ----------
    data
        (byte,) as sent; what follows the image, such as chunk data, is left out.
    pixel_format, columns, rows
        Of the image.
    padding
        Bytes at the end of each row.

    Returns
    -------
    numpy.ndarray
        (row, column), of its own memory.

    Raises
    ------
    DeviceError
        There are fewer bytes than the image has, or the format is not known.

    Notes
    -----
    PFNC 2.4: in the formats that end in p, pixels follow each other bit by bit, the least significant first.  Of
    GigE Vision's Mono12Packed, three bytes hold two pixels: the upper eight bits of the first, the lower four of both
    (the first's in the lower half), the upper eight of the second.

    Examples
    --------
    >>> unpack(np.array([0x34, 0x12, 0xFF, 0x0F], np.uint8), "Mono16", 2, 1)
    array([[4660, 4095]], dtype=uint16)
    """
    row_bytes = frame_bytes(pixel_format, columns, 1) if padding else 0
    needed = rows * (row_bytes + padding) if padding else frame_bytes(pixel_format, columns, rows)
    if len(data) < needed:
        raise DeviceError("camera", f"sent {len(data)} bytes; {columns} x {rows} pixels of {pixel_format} are {needed}")
    if padding:
        lines = data[:needed].reshape(rows, row_bytes + padding)[:, :row_bytes]
        return np.concatenate([_unpacked(line, pixel_format, columns)[None] for line in lines])
    return _unpacked(data[:needed], pixel_format, columns * rows).reshape(rows, columns)


def _unpacked(data: Bytes, pixel_format: str, count: int) -> NDArray[np.uint16]:
    if pixel_format == "Mono12Packed":
        first, both, second = _groups(data, 3)
        return _interleaved(count, (first << 4) | (both & 0xF), (second << 4) | (both >> 4))
    if pixel_format == "Mono12p":
        first, both, second = _groups(data, 3)
        return _interleaved(count, first | ((both & 0xF) << 8), (both >> 4) | (second << 4))
    if pixel_format == "Mono10p":
        a, b, c, d, e = _groups(data, 5)
        return _interleaved(
            count, a | ((b & 0x3) << 8), (b >> 2) | ((c & 0xF) << 6), (c >> 4) | ((d & 0x3F) << 4), (d >> 6) | (e << 2)
        )
    return data.astype(np.uint16) if full_level(pixel_format) == 255 else data.copy().view("<u2").astype(np.uint16)


def _groups(data: Bytes, size: int) -> NDArray[np.uint16]:
    """Return (place in its group, group); the last group is filled up."""
    filled = np.zeros(-(-len(data) // size) * size, np.uint16)
    filled[: len(data)] = data
    return filled.reshape(-1, size).T


def _interleaved(count: int, *pixels: NDArray[np.uint16]) -> NDArray[np.uint16]:
    return np.stack(pixels, axis=1).reshape(-1)[:count]
