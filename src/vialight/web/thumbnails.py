"""Small pictures of prints for the list of runs."""

from __future__ import annotations

import io
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError
from vialight.report import picture_of
from vialight.store import read_history, read_surface
from vialight.web.catalogue import history_of, surfaces_of
from vialight.web.runs import Mark, Run, mark_of, own_file

_PIXELS = 160
_MOST_BYTES = 500_000_000


def thumbnail(run: Run, is_live: bool) -> bytes | None:
    """Return the last surface of a run as PNG, or its newest projection; None where there is neither.

    A print that runs is shown by its projection, which costs nothing.
    """
    surfaces, moments = surfaces_of(run.folder), history_of(run.folder)
    is_surface = bool(surfaces and not (moments and is_live))
    if not (surfaces or moments):
        return None
    number = surfaces[-1] if is_surface else moments[-1]
    name = f"surfaces/{number:06d}.ply" if is_surface else f"history/{number:06d}.npz"
    path = own_file(run.folder, name, most_bytes=_MOST_BYTES)
    return None if path is None else _drawn(run.folder, is_surface, number, mark_of(path))


@lru_cache(maxsize=50)
def _drawn(folder: Path, is_surface: bool, number: int, mark: Mark | None) -> bytes | None:
    from PIL import Image

    try:
        image = picture_of(read_surface(folder, number), _PIXELS) if is_surface else _projection(folder, number)
    except InputError:
        return None
    buffer = io.BytesIO()
    Image.fromarray(image).save(buffer, format="PNG")
    return buffer.getvalue()


def _projection(folder: Path, number: int) -> NDArray[np.uint8]:
    """Return what has gelled, seen along y, upright."""
    seen = read_history(folder, number).cured.xz[::-1]
    levels = np.sqrt(np.nan_to_num(seen) / max(float(np.nanmax(seen)), 1e-9)) * 235 + 20
    step = max(1, -(-max(seen.shape) // _PIXELS))
    return np.ascontiguousarray(levels[::step, ::step].astype(np.uint8))
