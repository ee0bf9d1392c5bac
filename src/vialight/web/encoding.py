"""What goes to a browser, as bytes: a JSON header, then arrays, each at a multiple of 8 bytes.

Layout: uint32 length of the header, little-endian; the header in UTF-8; the arrays.  The header's ``arrays`` names
each with ``dtype``, ``shape`` and ``offset`` from the message's start.  Images are rounded to 254 levels between
``low`` and ``high`` (level 0 is NaN), surfaces to 16 bits of their extent: finer than a screen shows, and a quarter
of the bytes.
"""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from vialight.store import to_json

_ALIGN = 8
_LEVELS = 254
MOST_FACES = 600_000
"""Of a mesh that is sent as it is; a browser on a tablet turns so many."""


class _Planes(Protocol):
    @property
    def xy(self) -> NDArray[Any]: ...
    @property
    def xz(self) -> NDArray[Any]: ...
    @property
    def yz(self) -> NDArray[Any]: ...


class Levels(NamedTuple):
    """An image in 254 levels; 0 where there is no value."""

    levels: NDArray[np.uint8]
    low: float
    high: float


def to_levels(values: NDArray[Any], low: float | None = None, high: float | None = None) -> Levels:
    """Round an image to levels 1 to 255 between `low` and `high`, by default its own; NaN becomes 0.

    Examples
    --------
    >>> to_levels(np.array([[0.0, 2.0, float("nan"), 9.0]]), high=4.0).levels.tolist()
    [[1, 128, 0, 255]]
    """
    values = np.asarray(values, dtype=np.float32)
    known = np.isfinite(values)
    is_whole = bool(known.all())
    some = values if is_whole else values[known]
    low = float(some.min(initial=0.0)) if low is None else low
    high = float(some.max(initial=0.0)) if high is None else high
    scaled = (values - np.float32(low)) * np.float32(_LEVELS / max(high - low, 1e-30)) + np.float32(1.5)
    np.clip(scaled, 1, 255, out=scaled)
    if not is_whole:
        scaled[~known] = 0
    return Levels(scaled.astype(np.uint8), low, high)


def images_of(kind: str, planes: _Planes) -> dict[str, Levels]:
    """Return the images of three planes by name, one range for all three."""
    low, high = _range([planes.xy, planes.xz, planes.yz])
    return {f"{kind}_{plane}": to_levels(getattr(planes, plane), low, high) for plane in ("xy", "xz", "yz")}


def _range(images: list[NDArray[Any]]) -> tuple[float, float]:
    with np.errstate(invalid="ignore"):
        highs = [float(np.nanmax(image, initial=-math.inf)) for image in images]
        lows = [float(np.nanmin(image, initial=math.inf)) for image in images]
    low, high = min(lows), max(highs)
    return (low, high) if math.isfinite(low) and math.isfinite(high) else (0.0, 0.0)


def pack(header: Mapping[str, Any], arrays: Mapping[str, NDArray[Any] | Levels] | None = None) -> bytes:
    """Return a message.

    Parameters
    ----------
    header
        Plain JSON values; numbers that are not finite become null.
    arrays
        Name to array, or image in levels, whose range goes into the header.
    """
    described: dict[str, dict[str, Any]] = {}
    bodies: list[bytes] = []
    at = 0
    for name, item in (arrays or {}).items():
        array = item.levels if isinstance(item, Levels) else item
        body = np.ascontiguousarray(array).tobytes()
        described[name] = {"dtype": array.dtype.str[1:], "shape": list(array.shape), "offset": at}
        if isinstance(item, Levels):
            described[name] |= {"low": item.low, "high": item.high}
        bodies += [body, bytes(-len(body) % _ALIGN)]
        at += len(body) + len(bodies[-1])
    text = _text(header, described)
    return b"".join([struct.pack("<I", len(text)), text, *bodies])


def _text(header: Mapping[str, Any], described: Mapping[str, Mapping[str, Any]]) -> bytes:
    """Return the header, padded so that the arrays begin at a multiple of 8 bytes; their offsets count from there."""
    compact = json.dumps(json.loads(to_json({**header, "arrays": described})), separators=(",", ":"))
    text = compact.encode()
    return text + b" " * (-(len(text) + 4) % _ALIGN)


def unpack(message: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Read a message, as the page does; for tests and programs.

    Examples
    --------
    >>> header, arrays = unpack(pack({"kind": "snapshot"}, {"a": np.arange(3, dtype=np.uint16)}))
    >>> header["kind"], arrays["a"].tolist()
    ('snapshot', [0, 1, 2])
    """
    (length,) = struct.unpack_from("<I", message)
    header: dict[str, Any] = json.loads(message[4 : 4 + length])
    arrays = {
        name: np.frombuffer(
            message, np.dtype(f"<{item['dtype']}"), math.prod(item["shape"]), 4 + length + item["offset"]
        ).reshape(item["shape"])
        for name, item in header["arrays"].items()
    }
    return header, arrays


def pack_surface(
    header: Mapping[str, Any],
    vertices_mm: NDArray[Any],
    faces: NDArray[Any],
    deviation_mm: NDArray[Any] | None = None,
    *,
    most_faces: int = MOST_FACES,
) -> bytes:
    """Return a surface as a message: vertices in 16 bits of the extent, normals, faces, deviations.

    Parameters
    ----------
    header
        More to be told.
    vertices_mm
        (vertex, xyz).
    faces
        (face, corner).
    deviation_mm
        (vertex,); empty or None where there is no reference.
    most_faces
        About how many are sent; a finer mesh is simplified, and the header says so.
    """
    is_simplified = len(faces) > most_faces
    if is_simplified:
        vertices_mm, faces, deviation_mm = _clustered(vertices_mm, faces, deviation_mm, most_faces)
    vertices = np.asarray(vertices_mm, dtype=np.float32)
    corners = np.ascontiguousarray(faces, dtype=np.uint32)
    low = vertices.min(axis=0) if len(vertices) else np.zeros(3, np.float32)
    extent = np.maximum(vertices.max(axis=0) - low, 1e-6) if len(vertices) else np.ones(3, np.float32)
    arrays: dict[str, NDArray[Any] | Levels] = {
        "vertices": np.rint((vertices - low) * (65535 / extent)).astype(np.uint16),
        "normals": np.rint(127 * _normals(vertices, corners)).astype(np.int8),
        "faces": corners,
    }
    scale = {"low_mm": low, "extent_mm": extent, "simplified": is_simplified}
    if deviation_mm is not None and len(deviation_mm):
        known = np.nan_to_num(np.asarray(deviation_mm, dtype=np.float32))
        unit_mm = max(float(np.abs(known).max(initial=0.0)) / 32767, 1e-6)
        arrays["deviation"] = np.rint(known / unit_mm).astype(np.int16)
        scale |= {"deviation_unit_mm": unit_mm, "limit_mm": float(np.quantile(np.abs(known), 0.99))}
    return pack({**header, **scale}, arrays)


def _normals(vertices: NDArray[np.float32], faces: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Average the faces' normals at their corners, weighted by area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    area = np.cross(b - a, c - a)
    index = faces.ravel()
    sums = np.stack(
        [np.bincount(index, weights=np.repeat(area[:, axis], 3), minlength=len(vertices)) for axis in range(3)], axis=1
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    return np.asarray(sums / np.maximum(lengths, 1e-30), dtype=np.float32)


def _clustered(
    vertices_mm: NDArray[Any], faces: NDArray[Any], deviation_mm: NDArray[Any] | None, most_faces: int
) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any] | None]:
    """Merge what lies in one cell of a grid, so that a large mesh can be looked at; never measured on."""
    low, high = vertices_mm.min(axis=0), vertices_mm.max(axis=0)
    a, b, c = (vertices_mm[faces[:, corner]] for corner in range(3))
    area = float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()) / 2
    # A surface crosses some 1.5 cells for each square of a cell's edge of its area, and has two faces for each.
    cell = max(math.sqrt(3 * area / most_faces), 1e-6 * float(np.max(high - low)))
    keys = np.floor((vertices_mm - low) / cell).astype(np.int64)
    flat = (keys[:, 0] << 42) | (keys[:, 1] << 21) | keys[:, 2]
    _, first, of_vertex = np.unique(flat, return_index=True, return_inverse=True)
    merged = of_vertex[faces]
    a, b, c = merged.T
    kept = merged[(a != b) & (b != c) & (c != a)]
    has_deviation = deviation_mm is not None and len(deviation_mm) == len(vertices_mm)
    return vertices_mm[first], kept, deviation_mm[first] if has_deviation and deviation_mm is not None else None
