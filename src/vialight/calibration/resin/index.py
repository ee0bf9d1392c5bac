"""The resin's index from how large known cylinders appear."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vialight.core.arrays import FloatArray


@dataclass(frozen=True)
class IndexFit:
    """The index that makes known cylinders as large as they are.

    Parameters
    ----------
    index, std
        As found, and its standard uncertainty.
    edge_mm
        By how much the edge, at half the contrast, lies outside the true surface.
    """

    index: float
    std: float
    edge_mm: float


def index_from_cylinders(
    apparent_mm: FloatArray, true_mm: FloatArray, std_mm: FloatArray, edge_std_mm: float, index: float,
    scale_std: float = 0.0,
) -> IndexFit:  # fmt: skip
    """Fit the index: ``x_v = b / n``, so that with an index of `index` lengths appear ``n / index`` times as large.

    Density falls over a soft edge, and at half the contrast need not be the surface: the edge's place is fitted along,
    within its own softness.  With one cylinder that softness decides; cylinders of different size tell both apart.

    Parameters
    ----------
    apparent_mm, true_mm, std_mm
        (n,) radii at half the contrast, as known, and the standard uncertainty of the two.
    edge_std_mm
        How far the edge may lie from the surface.
    index
        With which they were reconstructed.
    scale_std
        Standard uncertainty of the camera's pixel as a share: lengths are in proportion to it too.

    Examples
    --------
    >>> true = np.array([2.0, 6.0])
    >>> fit = index_from_cylinders(true * 1.49 / 1.48 + 0.02, true, np.array([0.001, 0.001]), 0.1, 1.48)
    >>> round(fit.index, 3), round(fit.edge_mm, 3)
    (1.49, 0.02)
    """
    # Rows: each cylinder, and that the edge is near the surface.
    rows = np.vstack([np.stack([true_mm, np.ones_like(true_mm)], axis=1) / std_mm[:, None], [0.0, 1 / edge_std_mm]])
    values = np.append(apparent_mm / std_mm, 0.0)
    inverse = np.linalg.inv(rows.T @ rows)
    ratio, edge = inverse @ rows.T @ values
    std = index * float(np.hypot(np.sqrt(inverse[0, 0]), ratio * scale_std))
    return IndexFit(float(ratio) * index, std, float(edge))
