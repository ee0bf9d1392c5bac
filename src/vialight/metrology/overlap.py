"""How much of space two bodies share, by columns cut through them."""

from __future__ import annotations

import numpy as np

from vialight.core.columns import column_grid, crossings
from vialight.core.mesh import Mesh

COLUMNS_ACROSS = 400
"""Columns along the longer side of the region; along each column, lengths are exact."""


def intersection_over_union(one: Mesh, other: Mesh) -> float:
    """Measure the volume inside both bodies as a share of the volume inside either.

    The volumes are cut into columns along z, `COLUMNS_ACROSS` of them across the longer side; along a column the
    lengths are exact.  For smooth bodies that is good to about 3e-4.

    Parameters
    ----------
    one, other
        Closed meshes.

    Examples
    --------
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> raised = Mesh(corner.vertices_mm + [0, 0, 4], corner.faces)
    >>> intersection_over_union(corner, corner), intersection_over_union(corner, raised)
    (1.0, 0.0)
    """
    both = np.stack([one.bounds_mm, other.bounds_mm])
    bounds = np.stack([both[:, 0].min(axis=0), both[:, 1].max(axis=0)])
    grid = column_grid(bounds, axis=2, pitch_mm=float((bounds[1] - bounds[0])[:2].max()) / COLUMNS_ACROSS)
    cuts = [crossings(mesh, grid) for mesh in (one, other)]
    column = np.concatenate([cut.column for cut in cuts])
    height = np.concatenate([cut.height_mm for cut in cuts])
    order = np.lexsort((height, column))
    steps = np.zeros((2, len(order)), dtype=np.int64)
    steps[0, : len(cuts[0].column)] = -cuts[0].outward
    steps[1, len(cuts[0].column) :] = -cuts[1].outward
    # Going up a column, each face that looks down enters the body; no body is left open above, so that the sums are 0
    # between columns.
    inside = np.cumsum(steps[:, order], axis=1)[:, :-1] > 0
    lengths = np.diff(height[order])
    shared, either = lengths[inside.all(axis=0)].sum(), lengths[inside.any(axis=0)].sum()
    return float(shared / either) if either else 0.0
