"""Height maps of profilometers: NumPy, CSV and TIFF."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.errors import InputError
from vialight.store.npy import read_npy
from vialight.system import open_plain, read_plain

_MOST_BYTES = 200_000_000
"""Of a text or an image: 40 million heights."""

_WANTED = "a height map in mm: .npy, .csv or .tif of floats, NaN (in CSV also nothing) where nothing was measured"


def read_heights(path: str | Path) -> FloatArray:
    """Read a height map as it stands.

    Parameters
    ----------
    path
        ``.npy``, ``.csv`` (commas, semicolons, tabs or spaces between numbers, no head), ``.tif``.

    Returns
    -------
    numpy.ndarray
        (row, column) float64, mm; NaN where nothing was measured.

    Raises
    ------
    InputError
        The file cannot be read, is no map of one height a pixel, or holds integers, whose unit is not known.
    """
    path = Path(path)
    try:
        heights = _read(path)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted=_WANTED, remedy="check the path") from error
    except Exception as error:  # readers of images and arrays fail in as many ways as files are broken
        raise InputError(path, f"cannot be read ({type(error).__name__}: {error})", accepted=_WANTED) from error
    if heights.dtype.kind != "f":
        raise InputError(path, f"holds {heights.dtype}, whose unit is not known", accepted=_WANTED,
                         remedy="convert it to mm")  # fmt: skip
    if heights.ndim != 2 or min(heights.shape) < 16:
        raise InputError(path, f"has the shape {' x '.join(map(str, heights.shape))}", accepted=_WANTED)
    return np.where(np.isfinite(heights), heights, np.nan).astype(np.float64)


def _read(path: Path) -> np.ndarray:
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return read_npy(path)
    if suffix in (".csv", ".txt"):
        return np.array(
            [[_number(cell) for cell in row] for row in _cells(read_plain(path, _MOST_BYTES).decode("utf-8-sig"))]
        )
    if suffix in (".tif", ".tiff"):
        from PIL import Image

        with open_plain(path, _MOST_BYTES) as file, Image.open(file) as image:
            if (pages := getattr(image, "n_frames", 1)) != 1:
                raise InputError(path, f"has {pages} pages", accepted=_WANTED, remedy="choose one")
            return np.asarray(image)
    raise InputError(path, f"is of no kind that is read ({suffix or 'no suffix'})", accepted=_WANTED)


def _cells(text: str) -> list[list[str]]:
    lines = [line for line in text.splitlines() if line.strip()]
    mark = next((mark for mark in ";\t," if lines and mark in lines[0]), None)
    return [line.split(mark) for line in lines]


def _number(cell: str) -> float:
    return float(cell) if cell.strip() else np.nan
