"""A surface seen from outside: orthographic, shaded, coloured by what was measured at its vertices.

Drawn by scan conversion in NumPy rather than by OpenGL: it needs no display, no driver and no system package, and
gives the same bytes on every machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vialight.core.arrays import FloatArray
from vialight.core.columns import ColumnGrid, crossings
from vialight.core.mesh import Mesh

_OVERSAMPLING = 2
_LIGHT = np.array([-0.3, 0.35, 0.89])
_AMBIENT = 0.55
_CREASE_DEG = 40.0
_EDGE_SHARE = 0.012
"""Of the picture's width: steps in depth larger than this are drawn as lines."""
_EDGE_SHADE = 0.45


@dataclass(frozen=True)
class View:
    """A direction to look from.

    Parameters
    ----------
    title
        What it shows.
    right, up
        Unit vectors of the object frame that point right and up in the picture; ``right x up`` points at the viewer,
        so that nothing is mirrored.
    """

    title: str
    right: tuple[float, float, float]
    up: tuple[float, float, float]

    @property
    def axes(self) -> FloatArray:
        """(3, 3) rows: right, up, towards the viewer."""
        return np.array([self.right, self.up, np.cross(self.right, self.up)])


def _oblique(title: str, towards: tuple[float, float, float]) -> View:
    viewer = np.array(towards) / np.linalg.norm(towards)
    right = np.cross((0, 0, 1), viewer)
    right /= np.linalg.norm(right)
    up = np.cross(viewer, right)
    return View(title, tuple(right.tolist()), tuple(up.tolist()))


VIEWS = (
    View("front, as the camera sees it at stage angle 0", (1, 0, 0), (0, 0, 1)),
    View("from above", (1, 0, 0), (0, 1, 0)),
    _oblique("from the front right, above", (1.0, -1.5, 1.0)),
    _oblique("from the back left, below", (-1.0, 1.5, -1.0)),
)


@dataclass(frozen=True)
class Drawing:
    """A drawn view.

    Parameters
    ----------
    image
        (rows, columns, 4) uint8, red, green, blue, opacity; row 0 at the top.
    extent_mm
        Left, right, bottom, top in mm along the view's axes.
    """

    image: NDArray[np.uint8]
    extent_mm: tuple[float, float, float, float]


def draw(mesh: Mesh, colours: NDArray[np.uint8], view: View, pixel_mm: float) -> Drawing:
    """Draw a mesh with coloured vertices.

    Parameters
    ----------
    mesh
        What is seen.
    colours
        (n, 3) uint8, one a vertex.
    view
        Where from.
    pixel_mm
        Edge of a pixel of the picture.
    """
    turned = mesh.vertices_mm @ view.axes.T
    corner_normals = _corner_normals(mesh) @ view.axes.T
    seen = np.flatnonzero(mesh.face_normals @ view.axes[2] > 0) if mesh.is_closed else np.arange(len(mesh.faces))
    fine_mm = pixel_mm / _OVERSAMPLING
    low = turned.min(axis=0)[:2] - 2 * pixel_mm
    columns, rows = (np.ceil((turned.max(axis=0)[:2] + 2 * pixel_mm - low) / pixel_mm).astype(int)).tolist()
    grid = ColumnGrid(2, (float(low[0]), float(low[1])), fine_mm, (rows * _OVERSAMPLING, columns * _OVERSAMPLING))

    found = crossings(Mesh(turned, mesh.faces[seen]), grid)
    order = np.lexsort((found.height_mm, found.column))
    last = order[np.r_[np.diff(found.column[order]) > 0, True]]
    face, shares, pixel = seen[found.face[last]], found.shares[last], found.column[last]
    shade = _shade(np.einsum("ij,ijk->ik", shares, corner_normals[face]))
    colour = np.einsum("ij,ijk->ik", shares, colours[mesh.faces[face]].astype(np.float64))
    depth = np.full(grid.shape[0] * grid.shape[1], -np.inf)
    depth[pixel] = found.height_mm[last]
    flat = np.zeros((len(depth), 4))
    flat[pixel, :3] = colour * shade[:, None]
    flat[pixel, 3] = 255
    image = flat.reshape(*grid.shape, 4)
    image[_depth_edges(depth.reshape(grid.shape), _EDGE_SHARE * columns * pixel_mm), :3] *= _EDGE_SHADE
    left, lower = float(low[0]), float(low[1])
    return Drawing(_reduced(image)[::-1], (left, left + columns * pixel_mm, lower, lower + rows * pixel_mm))


def _corner_normals(mesh: Mesh) -> FloatArray:
    import igl

    normals = np.asarray(igl.per_corner_normals(mesh.vertices_mm, mesh.faces, _CREASE_DEG))
    return np.asarray(np.nan_to_num(normals.reshape(-1, 3, 3)))


def _shade(normals: FloatArray) -> FloatArray:
    lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    # A face of an open mesh may be seen from behind; it is lit as if it faced the viewer.
    lit = np.abs(normals @ (_LIGHT / np.linalg.norm(_LIGHT))) / lengths
    return np.asarray(_AMBIENT + (1 - _AMBIENT) * np.minimum(lit * 1.15, 1.0))


def _depth_edges(depth: FloatArray, step_mm: float) -> NDArray[np.bool_]:
    """Mark what lies in front of a step in depth, outlines included."""
    edges = np.zeros(depth.shape, dtype=bool)
    for axis in range(2):
        for direction in (1, -1):
            with np.errstate(invalid="ignore"):
                edges |= depth - np.roll(depth, direction, axis=axis) > step_mm
    return edges


def _reduced(image: FloatArray) -> NDArray[np.uint8]:
    """Average blocks of pixels, colours by their opacity."""
    rows, columns = (size // _OVERSAMPLING for size in image.shape[:2])
    blocks = image.reshape(rows, _OVERSAMPLING, columns, _OVERSAMPLING, 4)
    opacity = blocks[..., 3].sum(axis=(1, 3))
    colour = (blocks[..., :3] * blocks[..., 3:]).sum(axis=(1, 3)) / np.maximum(opacity, 1)[..., None]
    reduced = np.concatenate([colour, opacity[..., None] / _OVERSAMPLING**2], axis=2)
    return np.asarray(np.rint(reduced), dtype=np.uint8)
