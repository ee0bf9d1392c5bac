"""Triangle meshes in the object frame: what one is, and the measures that any mesh has."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from vialight.core.errors import InputError


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh in the object frame.

    Parameters
    ----------
    vertices_mm
        (n, 3) float64, finite.
    faces
        (m, 3) int64 indices into `vertices_mm`, counter-clockwise seen from outside.

    Raises
    ------
    InputError
        The arrays do not make a mesh: wrong shapes, coordinates that are not finite, faces of missing vertices.

    Examples
    --------
    >>> corner = Mesh([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 4]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    >>> corner.volume_mm3, corner.is_closed
    (4.0, True)
    """

    vertices_mm: NDArray[np.float64]
    faces: NDArray[np.int64]

    def __post_init__(self) -> None:
        vertices = np.ascontiguousarray(self.vertices_mm, dtype=np.float64)
        faces = np.ascontiguousarray(self.faces, dtype=np.int64)
        _check_arrays(vertices, faces)
        object.__setattr__(self, "vertices_mm", vertices)
        object.__setattr__(self, "faces", faces)

    @property
    def corners_mm(self) -> NDArray[np.float64]:
        """(m, 3, 3) coordinates: face, corner, xyz."""
        return np.asarray(self.vertices_mm[self.faces])

    @property
    def area_vectors_mm2(self) -> NDArray[np.float64]:
        """(m, 3) outward normals, each as long as its face is large."""
        a, b, c = np.moveaxis(self.corners_mm, 1, 0)
        return np.asarray(np.cross(b - a, c - a) / 2)

    @property
    def face_areas_mm2(self) -> NDArray[np.float64]:
        """(m,) areas of the faces."""
        return np.asarray(np.linalg.norm(self.area_vectors_mm2, axis=1))

    @property
    def face_normals(self) -> NDArray[np.float64]:
        """(m, 3) outward unit normals; zero for a face without area."""
        vectors = self.area_vectors_mm2
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        return np.asarray(np.divide(vectors, lengths, out=np.zeros_like(vectors), where=lengths > 0))

    @property
    def area_mm2(self) -> float:
        """Area of the whole surface."""
        return float(self.face_areas_mm2.sum())

    @property
    def face_volumes_mm3(self) -> NDArray[np.float64]:
        """(m,) signed volumes between the faces and one fixed point; their sum over a closed part is its volume."""
        a, b, c = np.moveaxis(self.corners_mm - self.bounds_mm.mean(axis=0), 1, 0)
        return np.asarray(np.einsum("ij,ij->i", a, np.cross(b, c)) / 6)

    @cached_property
    def volume_mm3(self) -> float:
        """Enclosed volume, negative where the mesh is inside out; means nothing unless `is_watertight`."""
        return float(self.face_volumes_mm3.sum())

    @property
    def bounds_mm(self) -> NDArray[np.float64]:
        """(2, 3) lowest and highest coordinates of the vertices that faces use."""
        used = self.vertices_mm[np.unique(self.faces)]
        return np.stack([used.min(axis=0), used.max(axis=0)])

    @property
    def extents_mm(self) -> NDArray[np.float64]:
        """(3,) lengths of the bounding box along x, y, z."""
        low, high = self.bounds_mm
        return np.asarray(high - low)

    @cached_property
    def is_watertight(self) -> bool:
        """Whether the faces bound something: every edge is walked as often one way as the other.

        That is what makes "inside" a question with an answer.  It is wider than two faces an edge (bodies that touch
        along an edge are allowed) and stricter than counting (faces that disagree about outside are not).
        """
        count = len(self.vertices_mm)
        faces = self.faces[_uncollapsed(self.faces)]
        start, end = faces.ravel(), np.roll(faces, -1, axis=1).ravel()
        forth, back = np.sort(start * count + end), np.sort(end * count + start)
        return bool(forth.size) and bool(np.array_equal(forth, back))

    @property
    def is_closed(self) -> bool:
        """Whether the mesh `is_watertight` and its faces look outwards, so that a signed distance means something."""
        return self.is_watertight and self.volume_mm3 > 0

    def moved(self, transform: NDArray[np.float64]) -> Mesh:
        """Return the mesh after a 4x4 rigid `transform` in mm."""
        return Mesh(self.vertices_mm @ transform[:3, :3].T + transform[:3, 3], self.faces)


def merge_coincident(
    vertices_mm: NDArray[np.float64], faces: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Make vertices one where all three coordinates are equal; faces keep their order and their corners' order.

    Examples
    --------
    >>> vertices, faces = merge_coincident(np.eye(3)[[0, 1, 2, 2, 1, 1]], np.array([[0, 1, 2], [3, 4, 5]]))
    >>> len(vertices), faces.tolist()
    (3, [[0, 1, 2], [2, 1, 1]])
    """
    order = np.lexsort(vertices_mm.T)
    ordered = vertices_mm[order]
    starts = np.r_[True, np.any(ordered[1:] != ordered[:-1], axis=1)]
    # lexsort is stable, so that the first of each group is the one that came first in the file.
    first_of_group = order[starts]
    rank = np.argsort(np.argsort(first_of_group))
    new_index = np.empty(len(order), dtype=np.int64)
    new_index[order] = rank[np.cumsum(starts) - 1]
    return vertices_mm[np.sort(first_of_group)], new_index[faces]


def piece_labels(mesh: Mesh) -> NDArray[np.int64]:
    """Tell for every face which piece of the mesh it belongs to: faces that share a vertex belong together.

    Returns
    -------
    numpy.ndarray
        (m,) int64, one label a face, from 0 upwards.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    count = len(mesh.vertices_mm)
    start, end = mesh.faces[:, :2].ravel(), mesh.faces[:, 1:].ravel()
    graph = coo_array((np.ones(len(start), dtype=np.int8), (start, end)), shape=(count, count))
    of_vertex = connected_components(graph, directed=False)[1]
    return np.unique(of_vertex[mesh.faces[:, 0]], return_inverse=True)[1].astype(np.int64)


def _check_arrays(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> None:
    for name, array in (("vertices", vertices), ("faces", faces)):
        if array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise InputError("mesh", f"{name} have shape {array.shape}", accepted="(n, 3) with n > 0")
    bad = np.count_nonzero(~np.isfinite(vertices).all(axis=1))
    if bad:
        raise InputError(
            "mesh", f"{bad} of {len(vertices)} vertices have NaN or infinite coordinates",
            accepted="finite coordinates in mm", remedy="export it again",
        )  # fmt: skip
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise InputError(
            "mesh", f"faces name vertices {faces.min()} to {faces.max()}", accepted=f"0 to {len(vertices) - 1}",
            remedy="export it again",
        )  # fmt: skip


def _uncollapsed(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    a, b, c = faces.T
    return np.asarray((a != b) & (b != c) & (c != a))
