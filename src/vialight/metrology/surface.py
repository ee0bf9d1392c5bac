"""Stage: the surface where the density crosses the gelation threshold."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import Float32Array, FloatArray, Volume
from vialight.core.errors import InputError
from vialight.core.mesh import Mesh, piece_labels
from vialight.metrology.contours import above_ties, contour


def isosurface(volume: Volume, threshold: float, *, smallest_piece_mm3: float = 0.0) -> Mesh:
    """Draw the surface where the density equals the threshold.

    The surface runs between voxel centres by linear interpolation (flying edges).  Where what is cured reaches the end
    of the grid, the surface is closed on the outer faces of the last voxels, which is where the measured part ends.

    Parameters
    ----------
    volume
        Density, counts per mm.
    threshold
        Gelation threshold I_p in the same counts per mm.
    smallest_piece_mm3
        Loose pieces and bubbles of less volume than this are left out; by default nothing is.

    Returns
    -------
    Mesh
        Closed, in the object frame, faces outward: towards lower density.

    Raises
    ------
    InputError
        The threshold or the density is not finite, or nothing, or everything, lies above the threshold.

    Examples
    --------
    >>> from vialight.core.arrays import Grid
    >>> grid = Grid((21, 21, 21), 0.1)
    >>> z, y, x = np.meshgrid(grid.z_mm, grid.y_mm, grid.x_mm, indexing="ij")
    >>> cone = (1 - np.sqrt(x**2 + y**2 + z**2)).astype(np.float32)
    >>> bool(np.allclose(isosurface(Volume(cone, grid), 0.5).extents_mm, 1.0, atol=1e-3))
    True
    """
    low, high = float(volume.density.min()), float(volume.density.max())
    if not np.isfinite(threshold):
        raise InputError("threshold", f"is {threshold}", accepted="a finite density, counts per mm")
    if not np.isfinite(low + high):
        raise InputError("volume", "holds densities that are NaN or infinite", accepted="finite counts per mm")
    if not low < threshold < high:
        raise InputError(
            "threshold", f"no surface at {threshold:g}",
            accepted=f"within the densities found, {low:.4g} to {high:.4g}",
            remedy="choose a threshold in between, or check exposure and background",
        )  # fmt: skip
    mesh = _flying_edges(volume, threshold)
    return mesh if smallest_piece_mm3 <= 0 else _without_small_pieces(mesh, smallest_piece_mm3)


def pieces(mesh: Mesh) -> FloatArray:
    """Return the volumes of a mesh's separate pieces, largest first.

    Returns
    -------
    numpy.ndarray
        (pieces,) mm^3; a cavity inside a part is a piece of its own, with negative volume.

    Examples
    --------
    >>> block = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> pieces(block)
    array([4.])
    """
    volumes = _piece_volumes(mesh, piece_labels(mesh))
    return np.sort(volumes)[::-1]


def _piece_volumes(mesh: Mesh, labels: np.ndarray[tuple[int], np.dtype[np.int64]]) -> FloatArray:
    return np.asarray(np.bincount(labels, weights=mesh.face_volumes_mm3), dtype=np.float64)


def _without_small_pieces(mesh: Mesh, smallest_mm3: float) -> Mesh:
    labels = piece_labels(mesh)
    volumes = np.abs(_piece_volumes(mesh, labels))
    if volumes.max() < smallest_mm3:
        raise InputError(
            "surface", f"no piece reaches {smallest_mm3:g} mm^3", accepted=f"at most {volumes.max():.4g} mm^3",
            remedy="ask for less, or check the threshold",
        )  # fmt: skip
    faces = mesh.faces[volumes[labels] >= smallest_mm3]
    used, renumbered = np.unique(faces, return_inverse=True)
    return Mesh(mesh.vertices_mm[used], renumbered.reshape(faces.shape))


def _flying_edges(volume: Volume, threshold: float) -> Mesh:
    level, grid = above_ties(threshold), volume.grid
    density, layers = _closed_at_the_edge(volume.density, level)
    z, y, x = (origin - layers * grid.voxel_mm for origin in grid.origin_mm)
    return contour(density, (z, y, x), grid.voxel_mm, level)


def _closed_at_the_edge(density: Float32Array, threshold: float) -> tuple[Float32Array, int]:
    """Return the density with, where needed, one more layer all round that is below the threshold.

    The layer mirrors the last voxels' excess over the threshold, so that interpolation ends half a voxel outside their
    centres.  A volume that is below the threshold all round is returned as it is: it may be hundreds of megabytes.
    """
    rims = (
        (density[end] for end in (0, -1)),
        (density[:, end] for end in (0, -1)),
        (density[..., end] for end in (0, -1)),
    )
    if all(rim.max() < threshold for pair in rims for rim in pair):
        return np.ascontiguousarray(density, dtype=np.float32), 0
    padded = np.pad(density, 1, mode="edge").astype(np.float32, copy=False)
    for axis in range(3):
        for end in (0, -1):
            layer = np.moveaxis(padded, axis, 0)[end]
            np.minimum(layer, 2 * threshold - layer, out=layer, casting="same_kind")
    return padded, 1
