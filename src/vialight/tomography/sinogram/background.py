"""From camera counts to line integrals."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import Float32Array
from vialight.core.errors import InputError


def bin_frames(counts: NDArray[Any], binning: int) -> Float32Array:
    """Sum squares of `binning` x `binning` pixels; rows and columns that do not fill one are left off.

    Parameters
    ----------
    counts
        (..., row, column).
    binning
        1 or more.
    """
    rows, columns = (size // binning for size in counts.shape[-2:])
    cut = counts[..., : rows * binning, : columns * binning].astype(np.float32, copy=False)
    if binning == 1:
        return cut
    blocks = cut.reshape(*cut.shape[:-2], rows, binning, columns, binning)
    return np.asarray(blocks.sum(axis=(-3, -1)), dtype=np.float32)


def attenuation(counts: Float32Array, white: Float32Array, dark: Float32Array | None) -> Float32Array:
    """Return minus the logarithm of transmission, for instruments that look through the object.

    Parameters
    ----------
    counts
        (frame, row, column).
    white, dark
        (row, column) means of frames without the object and without light.

    Raises
    ------
    InputError
        The white frames are nowhere brighter than the dark ones.
    """
    dark = np.zeros_like(white) if dark is None else dark
    open_beam = white - dark
    if not (open_beam > 0).any():
        raise InputError("/exchange/data_white", "is nowhere brighter than /exchange/data_dark", accepted="open beam")
    # A dead or black pixel has no logarithm: it is held at a millionth of the beam, far below any real transmission.
    floor = 1e-6 * float(np.median(open_beam[open_beam > 0]))
    transmitted = np.maximum(counts - dark, floor) / np.maximum(open_beam, floor)
    return np.asarray(-np.log(transmitted), dtype=np.float32)
