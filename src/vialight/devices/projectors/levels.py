"""Levels that are sent for levels that are planned: what a projector's light really does with them.

A plan's level is a share of the full light.  A projector's light need not be proportional to the level it is sent, nor
even over its image: both are put right here, once, when patterns are loaded.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.errors import InputError

FULL = 255


def light_of_levels(linearisation: tuple[tuple[float, float], ...] | None) -> FloatArray:
    """Return (256,) the light of each level as a share of that of level 255, by straight lines between measured ones.

    Examples
    --------
    >>> light_of_levels(((0.0, 0.0), (128.0, 1.0), (255.0, 4.0)))[[0, 64, 128, 255]].tolist()
    [0.0, 0.125, 0.25, 1.0]
    """
    levels = np.arange(FULL + 1, dtype=np.float64)
    if linearisation is None:
        return levels / FULL
    measured = np.array(linearisation, dtype=np.float64)
    light = np.interp(levels, measured[:, 0], measured[:, 1])
    return np.asarray(light / light[FULL], dtype=np.float64)


def sent_levels(
    planned: NDArray[np.uint8], light: FloatArray, flat_field: Float32Array | None = None
) -> NDArray[np.uint8]:
    """Return the levels whose light is nearest to what is planned; black stays black.

    Parameters
    ----------
    planned
        (row, column) levels, proportional to light.
    light
        (256,) of `light_of_levels`.
    flat_field
        (row, column) by which light is multiplied, 0 to 1.

    Examples
    --------
    >>> light = light_of_levels(((0.0, 0.0), (128.0, 1.0), (255.0, 4.0)))
    >>> sent_levels(np.array([[0, 32, 64, 255]], np.uint8), light).tolist()
    [[0, 64, 128, 255]]
    """
    between = (light[1:] + light[:-1]) / 2
    if flat_field is None:
        table = np.searchsorted(between, np.arange(FULL + 1) / FULL).astype(np.uint8)
        table[0] = 0
        return table[planned]
    wanted = planned * (flat_field / np.float32(FULL))
    sent = np.searchsorted(between.astype(np.float32), wanted).astype(np.uint8)
    sent[planned == 0] = 0
    return sent


def read_flat_field(path: Path, shape: tuple[int, int]) -> Float32Array:
    """Read a flat field: a grey image in the projector's pixels, white being 1; its values count as they are.

    Raises
    ------
    InputError
        It cannot be read, is no grey image, or has another size.
    """
    from PIL import Image, UnidentifiedImageError

    accepted = f"a grey PNG of {shape[1]} x {shape[0]} pixels, 8 or 16 bits"
    try:
        with Image.open(path) as image:
            values = np.asarray(image)
    except (OSError, UnidentifiedImageError) as error:
        raise InputError(f"flat field {path}", f"cannot be read ({error})", accepted=accepted) from error
    if values.shape != shape or values.dtype.kind not in "ui":
        size = " x ".join(map(str, values.shape[1::-1]))
        raise InputError(f"flat field {path}", f"is {values.dtype} of {size} pixels", accepted=accepted)
    white = FULL if values.dtype == np.uint8 else 65535
    return (values / np.float32(white)).astype(np.float32)
