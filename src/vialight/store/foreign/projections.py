"""Projections that another program computed: arrays and image stacks, with their angles.

Nothing about them is guessed: which axis is which, and which way it runs, is said by whoever reads them.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.errors import InputError
from vialight.store.npy import opened_npz, read_npy
from vialight.system import check_plain, need_memory, open_plain, read_plain

ARRAY_SUFFIXES = (".npy", ".npz")
IMAGE_SUFFIXES = (".png", ".tif", ".tiff")
_AXES = ("angle", "row", "column")
_NPY = b"\x93NUMPY"
_MOST_BYTES = 1 << 40
_MOST_LISTED_BYTES = 4_000_000
_LARGE_BYTES = 250_000_000
_MOST_PACKED = 260
"""Times that images are packed; patterns that are mostly black, to a hundredth."""
_MODE_BYTES = {"1": 1, "L": 1, "P": 1, "LA": 2, "PA": 2, "I;16": 2, "I;16L": 2, "I;16B": 2, "RGB": 3}
"""Of a pixel, by Pillow's names of kinds; of all others there are four."""
_FLOAT32_BYTES = 4
_FEWER = "take fewer or smaller images, or a machine with more memory"
_WANTED = ".npy, .npz, a TIFF of many pages, or a folder of PNG or TIFF images"


def read_projections(
    path: str | Path,
    *,
    axes: str,
    angles: str | Path | Sequence[float] | NDArray[Any] | None = None,
    span_deg: float | None = None,
    angle_unit: Literal["deg", "rad"] = "deg",
    name: str | None = None,
) -> tuple[Float32Array, FloatArray]:
    """Read projections as they stand: values are neither scaled nor clipped.

    Parameters
    ----------
    path
        ``.npy``, ``.npz``, a TIFF of many pages, or a folder of PNG or TIFF images, taken in the order of the numbers
        in their names.
    axes
        What the array's axes are, in its order, such as ``"angle,row,column"``: `row` counts downwards and `column` to
        the right as the projector shows them; ``-row`` and ``-column`` count the other way, ``-angle`` comes last
        first.  A stack of images has the order (image, down, right).
    angles
        The angles, in the array's order: numbers, or a file of them (``.npy``, or text with one a line).
    span_deg
        In place of `angles`: they are even over this span from 0, its end left out; 180 or 360.
    angle_unit
        Of `angles`.
    name
        Which array of an ``.npz`` that holds several.

    Returns
    -------
    values : numpy.ndarray
        (angle, row, column) float32.
    angles_rad : numpy.ndarray
        (angle,) float64.

    Raises
    ------
    InputError
        A file cannot be read, holds something else, or values and angles do not fit each other.

    Examples
    --------
    >>> import tempfile
    >>> path = Path(tempfile.mkdtemp()) / "sinogram.npy"
    >>> np.save(path, np.zeros((64, 90, 32)))  # (r, theta, z), as VAMToolbox has it
    >>> values, angles_rad = read_projections(path, axes="column,angle,-row", span_deg=180)
    >>> values.shape, float(np.rad2deg(angles_rad[1]))
    ((90, 32, 64), 2.0)
    """
    path = Path(path)
    order, reversed_axes = _parse_axes(axes)
    values = _read_values(path, name)
    if values.ndim != 3 or not values.size or values.dtype.kind not in "uif":
        raise InputError(
            path, f"is {values.dtype} of shape {values.shape}", accepted=f"numbers with three axes, {axes}"
        )
    values = np.transpose(np.flip(values, reversed_axes), order).astype(np.float32, order="C")
    if not np.isfinite(values).all():
        raise InputError(path, "holds values that are NaN or infinite", accepted="finite light, 0 or more")
    if values.min() < 0:
        raise InputError(
            path, f"holds negative values, down to {values.min():.4g}", accepted="light, 0 or more",
            remedy="clip them: a projector cannot take light away",
        )  # fmt: skip
    if (angles is None) is (span_deg is None):
        raise InputError(
            path, "needs its angles, said in one way", accepted="a file of angles, or the span over which they are even"
        )
    if angles is None:
        return values, _even_angles(len(values), span_deg)
    angles_rad = _listed_angles(len(values), angles, angle_unit)
    return values, np.flip(angles_rad) if order[0] in reversed_axes else angles_rad


def _parse_axes(axes: str) -> tuple[list[int], tuple[int, ...]]:
    """Return which axis of the array becomes which of (angle, row, column), and which are to be reversed."""
    given = [part.strip() for part in axes.split(",")]
    names = [part.removeprefix("-") for part in given]
    if sorted(names) != sorted(_AXES):
        raise InputError(
            "--axes", f"is {axes!r}",
            accepted="angle, row and column in the order of the array, such as column,angle,-row",
        )  # fmt: skip
    return [names.index(axis) for axis in _AXES], tuple(k for k, part in enumerate(given) if part.startswith("-"))


def _read_values(path: Path, name: str | None) -> NDArray[Any]:
    suffix = path.suffix.lower()
    try:
        if path.is_dir():
            return _read_folder(path)
        if suffix in IMAGE_SUFFIXES:
            return _read_pages(path)
        if suffix in ARRAY_SUFFIXES:
            return _read_array(path, name)
    except InputError:
        raise
    except FileNotFoundError as error:
        raise InputError(path, "there is no such file", accepted=_WANTED, remedy="check the path") from error
    except Exception as error:  # readers of images and arrays fail in as many ways as files are broken
        raise InputError(
            path, f"is damaged, or not what its name says ({type(error).__name__}: {error})", accepted=_WANTED,
            remedy="export it again",
        ) from error  # fmt: skip
    raise InputError(path, f"is of no kind that is read ({suffix or 'no suffix'})", accepted=_WANTED)


def _read_array(path: Path, name: str | None) -> NDArray[Any]:
    with open_plain(path, _MOST_BYTES) as file:
        is_single = file.read(len(_NPY)) == _NPY
    if is_single:
        return read_npy(path)
    with opened_npz(path, most_bytes=_MOST_BYTES) as held:
        names = [name] if name else [key for key in held if len(held.shape(key)) == 3]
        if len(names) != 1 or names[0] not in held:
            raise InputError(
                path, f"holds the arrays {', '.join(held) or 'none'}",
                accepted="one with three axes", remedy="save by itself the one that is meant",
            )  # fmt: skip
        return held[names[0]]


def _read_folder(folder: Path) -> NDArray[Any]:
    files = sorted((path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES), key=_by_numbers)
    if not files:
        raise InputError(folder, "holds no images", accepted=", ".join(IMAGE_SUFFIXES), remedy="check the path")
    pages: list[tuple[str, NDArray[Any]]] = []
    stored_bytes = sum(check_plain(path) for path in files)
    for path in files:
        stack = _read_pages(path)
        _check_stated(folder, len(files), len(files) * stack.size, len(files) * stack.nbytes, stored_bytes)
        pages += [(path.name, page) for page in stack]
    return _stacked(folder, pages)


def _check_stated(path: Path, count: int, pixels: int, stated_bytes: int, stored_bytes: int) -> None:
    """Refuse images that state far more than is stored, or more than fits into memory."""
    if stated_bytes > _LARGE_BYTES and stated_bytes > _MOST_PACKED * stored_bytes:
        raise InputError(
            path,
            f"states {count} images, {stated_bytes / 1e9:.4g} GB, in {stored_bytes} bytes",
            accepted="images that are there",
            remedy="export it again",
        )
    need_memory(stated_bytes + _FLOAT32_BYTES * pixels, path, f"a stack of {count} images", _FEWER)


def _read_pages(path: Path) -> NDArray[Any]:
    from PIL import Image, ImageSequence

    with open_plain(path, _MOST_BYTES) as file, Image.open(file) as image:
        stored_bytes = file.seek(0, 2)
        count = getattr(image, "n_frames", 1)
        stated_bytes, first = 0, image.size
        for index in range(count):  # what each page states is known before any is decoded
            image.seek(index)
            if image.size != first:
                raise InputError(
                    path, f"page 0 is {first}, page {index} is {image.size}", accepted="images of one size and kind"
                )
            stated_bytes += image.width * image.height * _MODE_BYTES.get(image.mode, 4)
        _check_stated(path, count, count * image.width * image.height, stated_bytes, stored_bytes)
        pages = enumerate(ImageSequence.Iterator(image))
        return _stacked(path, [(f"page {index}", _grey(path, page)) for index, page in pages])


def _stacked(path: Path, images: list[tuple[str, NDArray[Any]]]) -> NDArray[Any]:
    (first_name, first), *others = images
    for image_name, image in others:
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                path, f"{first_name} is {first.dtype} {first.shape}, {image_name} is {image.dtype} {image.shape}",
                accepted="images of one size and kind",
            )  # fmt: skip
    return np.stack([image for _, image in images])


def _grey(path: Path, image: Any) -> NDArray[Any]:
    pixels = np.asarray(image)
    if image.mode in ("RGB", "RGBA") and (pixels[..., :3] == pixels[..., :1]).all():
        return pixels[..., 0]
    if pixels.ndim != 2 or image.mode == "P":
        raise InputError(path, f"has colours (mode {image.mode})", accepted="grey images", remedy="export it as grey")
    return pixels.astype(np.uint8) if pixels.dtype == np.bool_ else pixels


def _by_numbers(path: Path) -> list[tuple[int, str]]:
    """Sort 2 before 10, as people who number files mean it."""
    parts = re.split(r"(\d+)", path.stem)
    return [(int(part), "") if part.isdigit() else (-1, part) for part in parts]


def _even_angles(count: int, span_deg: float | None) -> FloatArray:
    if span_deg not in (180, 360):
        raise InputError("--span", f"is {span_deg}", accepted="180 or 360 degrees", remedy="give a file of angles")
    return np.asarray(np.radians(span_deg) * np.arange(count) / count)


def _listed_angles(
    count: int, angles: str | Path | Sequence[float] | NDArray[Any], unit: Literal["deg", "rad"]
) -> FloatArray:
    where = angles if isinstance(angles, str | Path) else "angles"
    values = _read_angles(Path(angles)) if isinstance(angles, str | Path) else np.asarray(angles, dtype=np.float64)
    if values.shape != (count,):
        raise InputError(where, f"holds angles of shape {values.shape}", accepted=f"{count}, one a projection")
    if not np.isfinite(values).all():
        raise InputError(where, "holds angles that are NaN or infinite", accepted="finite angles")
    if unit == "deg" and count > 2 and np.ptp(values) < 2 * math.pi + 0.01:
        raise InputError(
            where, f"spans {np.ptp(values):.4g} degrees", accepted="angles about a part",
            remedy="if they are radians, say so with the unit",
        )  # fmt: skip
    return values if unit == "rad" else np.radians(values)


def _read_angles(path: Path) -> FloatArray:
    try:
        if path.suffix.lower() == ".npy":
            return np.asarray(read_npy(path), dtype=np.float64)
        lines = read_plain(path, _MOST_LISTED_BYTES).decode().splitlines()
        return np.asarray(np.loadtxt(lines, ndmin=1), dtype=np.float64)
    except InputError:
        raise
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            path, f"is no list of angles ({error})", accepted=".npy, or text with an angle a line"
        ) from error
