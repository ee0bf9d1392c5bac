"""Cylindrical faces of a mesh, found by what adjoining triangles have in common."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from vialight.core.arrays import BoolArray, FloatArray, IntArray
from vialight.core.mesh import Mesh

_SMOOTH_DEG = (0.3, 35.0)
"""Faces that meet at such angles may stand for one curved face; below they are coplanar, above there is an edge."""
_MAX_DIRECTIONS = 6
_MAX_CYLINDERS_PER_DIRECTION = 24
_LEAST_SHARE = 0.02
"""Of all bent edges, those that must speak for a direction; freeform parts have none that does."""
_FIT_TOLERANCE = 0.02
"""Of the radius: how far a face's corners may lie off its cylinder."""
_CANDIDATES, _VOTERS = 64, 4000
"""Votes that are looked at to find where the others agree."""
_AGREE = 0.05
"""Of the radius: how far votes for one centre may lie apart."""
_ALONG = 0.05
"""Sine of the angle that a face may make with the axis; irregular triangles on a cylinder do not lie quite along it."""
_ALONG_RMS = 0.015
"""Of that sine over a whole face; a band round a sphere or a torus, cut off at 0.05, has 0.029."""
_LEAST_ARC_DEG = 120.0
"""Shorter arcs do not tell a diameter."""


class CylindricalFace(NamedTuple):
    """A cylinder and the faces of the reference that lie on it."""

    faces: IntArray
    point_mm: FloatArray
    direction: FloatArray
    radius_mm: float
    height_mm: float
    arc_deg: float
    is_hole: bool


def cylindrical_faces(mesh: Mesh) -> tuple[CylindricalFace, ...]:
    """Find the cylindrical faces of a mesh, largest first.

    Adjoining faces of a cylinder have normals in one plane, across the axis.  So the bent edges between faces vote for
    directions ``n1 x n2``; the faces along a direction vote for centres, where the normals of neighbours meet; and
    what agrees with a centre to 2 % of the radius, hangs together and spans 120 deg is a cylindrical face.
    """
    bends = _bends(mesh)
    found: list[CylindricalFace] = []
    for direction in _directions(bends):
        is_along = np.abs(mesh.face_normals @ direction) < _ALONG
        is_along &= mesh.face_areas_mm2 > 0
        for face in found:
            is_along[face.faces] = False
        found += _faces_along(mesh, bends, direction, is_along)
    return tuple(sorted(found, key=lambda face: -float(mesh.face_areas_mm2[face.faces].sum())))


class _Bends(NamedTuple):
    """Smooth edges between faces."""

    pairs: IntArray
    """(n, 2) faces that adjoin, coplanar or bent."""
    direction: FloatArray
    """(n, 3) unit n1 x n2; zero where coplanar."""
    weight: FloatArray
    """(n,) length of the edge times the angle in rad."""


def _bends(mesh: Mesh) -> _Bends:
    start, end = mesh.faces.ravel(), np.roll(mesh.faces, -1, axis=1).ravel()
    key = np.minimum(start, end) * len(mesh.vertices_mm) + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    first = np.flatnonzero(key[order][1:] == key[order][:-1])
    pairs = np.stack([order[first] // 3, order[first + 1] // 3], axis=1)
    lengths = np.linalg.norm(mesh.vertices_mm[start] - mesh.vertices_mm[end], axis=1)[order[first]]
    normals = mesh.face_normals[pairs]
    across = np.cross(normals[:, 0], normals[:, 1])
    sine = np.linalg.norm(across, axis=1)
    angle = np.arctan2(sine, np.einsum("ij,ij->i", normals[:, 0], normals[:, 1]))
    low, high = np.radians(_SMOOTH_DEG)
    is_bent = angle > low
    direction = np.where(is_bent[:, None], across / np.maximum(sine, 1e-12)[:, None], 0.0)
    is_smooth = angle < high
    return _Bends(pairs[is_smooth], direction[is_smooth], (lengths * angle * is_bent)[is_smooth])


def _directions(bends: _Bends) -> list[FloatArray]:
    """Return the directions that most bent edges vote for."""
    is_bent = bends.weight > 0
    ballot = _some(np.column_stack([bends.direction, bends.weight])[is_bent], 5 * _VOTERS)
    votes, weights = ballot[:, :3], ballot[:, 3].copy()
    total = weights.sum()
    chosen: list[FloatArray] = []
    while len(chosen) < _MAX_DIRECTIONS and weights.max(initial=0.0) > 0:
        # Candidates are the heaviest votes left: a cylinder's are many, and nearly the same.
        candidates = votes[np.argsort(-weights)[:64]]
        agrees = np.abs(votes @ candidates.T) > np.cos(np.radians(2.0))
        best = int(np.argmax(weights @ agrees))
        share = weights[agrees[:, best]].sum()
        if share < _LEAST_SHARE * total:
            break
        voters = votes[agrees[:, best]] * np.sign(votes[agrees[:, best]] @ candidates[best])[:, None]
        mean = (weights[agrees[:, best], None] * voters).sum(axis=0)
        chosen.append(mean / np.linalg.norm(mean))
        weights[np.abs(votes @ chosen[-1]) > np.cos(np.radians(4.0))] = 0
    return chosen


def _faces_along(mesh: Mesh, bends: _Bends, direction: FloatArray, is_along: BoolArray) -> list[CylindricalFace]:
    """Return the cylindrical faces about axes in one direction."""
    across = np.linalg.svd(direction[None])[2][1:]
    flat = mesh.corners_mm @ across.T
    votes = _centre_votes(mesh, bends, across, is_along)
    found = []
    for _ in range(_MAX_CYLINDERS_PER_DIRECTION):
        if not len(votes):
            break
        centre, radius, agree = _strongest(votes)
        inliers = is_along.copy()
        for _ in range(3):
            inliers = is_along & _on_circle(flat, centre, radius)
            if np.count_nonzero(inliers) < 3:
                break
            centre, radius = _fit_circle(flat[inliers].reshape(-1, 2), np.repeat(mesh.face_areas_mm2[inliers], 3))
        groups = _connected(bends.pairs, inliers) if inliers.any() else []
        faces = [_described(mesh, group, across, centre, radius) for group in groups]
        found += [face for face in faces if _is_cylinder(mesh, face)]
        is_near = np.hypot(*(votes[:, :2] - centre).T) + np.abs(votes[:, 2] - radius) < 0.1 * radius
        votes = votes[~(agree | is_near)]
        is_along[np.concatenate([face.faces for face in found] or [np.empty(0, np.int64)])] = False
    return found


def _is_cylinder(mesh: Mesh, face: CylindricalFace) -> bool:
    sine = mesh.face_normals[face.faces] @ face.direction
    rms = np.sqrt(np.average(sine**2, weights=mesh.face_areas_mm2[face.faces]))
    return bool(face.arc_deg >= _LEAST_ARC_DEG and len(face.faces) >= 6 and rms < _ALONG_RMS)


def _centre_votes(mesh: Mesh, bends: _Bends, across: FloatArray, is_along: BoolArray) -> FloatArray:
    """Return (n, 4) votes: centre in the plane across, radius, weight.

    Seen along the axis, a face is a chord; neighbouring chords' perpendicular bisectors meet at the centre.
    """
    use = (bends.weight > 0) & is_along[bends.pairs].all(axis=1)
    pairs = bends.pairs[use]
    flat = mesh.corners_mm @ across.T
    normal = mesh.face_normals @ across.T
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    along = np.einsum("ijk,ik->ij", flat, tangent)
    middle = flat.mean(axis=1)
    middle += tangent * ((along.min(axis=1) + along.max(axis=1)) / 2 - along.mean(axis=1))[:, None]
    (p, q), (n, m) = np.moveaxis(middle[pairs], 1, 0), np.moveaxis(normal[pairs], 1, 0)
    # p - r n = q - r m, in the least squares: the signed radius is positive where normals look away from the centre.
    radius = np.einsum("ij,ij->i", p - q, n - m) / np.maximum(np.einsum("ij,ij->i", n - m, n - m), 1e-12)
    centre = (p - radius[:, None] * n + q - radius[:, None] * m) / 2
    votes = np.column_stack([centre, np.abs(radius), bends.weight[use]])
    return np.asarray(votes[(np.abs(radius) > 0) & (np.abs(radius) < 2 * mesh.extents_mm.max())])


def _strongest(votes: FloatArray) -> tuple[FloatArray, float, BoolArray]:
    """Return centre and radius where the votes are densest, in units of the radius, and which votes agree there."""
    candidates = _some(votes[np.argsort(-votes[:, 3], kind="stable")], _CANDIDATES)
    voters = _some(votes, _VOTERS)
    agree = np.ones((len(voters), len(candidates)), dtype=bool)
    for k in range(3):
        agree &= np.abs(voters[:, k, None] - candidates[:, k]) < _AGREE * candidates[:, 2]
    best = candidates[np.argmax(voters[:, 3] @ agree)]
    agree = np.asarray(np.abs(votes[:, :3] - best[:3]).max(axis=1) < _AGREE * best[2])
    mean = np.average(votes[agree, :3], axis=0, weights=votes[agree, 3])
    return mean[:2], float(mean[2]), agree


def _some(rows: FloatArray, count: int) -> FloatArray:
    """Return every so-manieth row, about `count` of them."""
    return rows[:: max(1, len(rows) // count)]


def _on_circle(flat: FloatArray, centre: FloatArray, radius: float) -> BoolArray:
    off = np.abs(np.linalg.norm(flat - centre, axis=2) - radius)
    return np.asarray(off.max(axis=1) < _FIT_TOLERANCE * radius)


def _fit_circle(points: FloatArray, weights: FloatArray) -> tuple[FloatArray, float]:
    """Fit a circle algebraically (Kasa): linear, and exact for points on one."""
    root = np.sqrt(weights)[:, None]
    middle = points.mean(axis=0)
    rows = np.column_stack([2 * (points - middle), np.ones(len(points))])
    x, y, rest = np.linalg.lstsq(rows * root, ((points - middle) ** 2).sum(axis=1) * root[:, 0], rcond=None)[0]
    return middle + np.array([x, y]), float(np.sqrt(max(rest + x * x + y * y, 0.0)))


def _connected(pairs: IntArray, is_member: BoolArray) -> list[IntArray]:
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    inside = pairs[is_member[pairs].all(axis=1)]
    count = len(is_member)
    graph = coo_array((np.ones(len(inside), dtype=np.int8), (inside[:, 0], inside[:, 1])), shape=(count, count))
    labels = connected_components(graph, directed=False)[1]
    members = np.flatnonzero(is_member)
    order = np.argsort(labels[members], kind="stable")
    cuts = np.flatnonzero(np.diff(labels[members][order])) + 1
    return np.split(members[order], cuts)


def _described(mesh: Mesh, faces: IntArray, across: FloatArray, centre: FloatArray, radius: float) -> CylindricalFace:
    corners = mesh.corners_mm[faces]
    direction = np.cross(across[0], across[1])
    along = corners.reshape(-1, 3) @ direction
    low, high = float(along.min()), float(along.max())
    flat = corners @ across.T - centre
    angles = np.sort(np.arctan2(flat[..., 1], flat[..., 0]).ravel())
    widest_gap = np.diff(np.r_[angles, angles[0] + 2 * np.pi]).max()
    outward = np.einsum("ij,ij->i", flat.mean(axis=1), mesh.face_normals[faces] @ across.T)
    # A gap no wider than one facet is none.
    facet = np.ptp(np.unwrap(np.arctan2(flat[..., 1], flat[..., 0]), axis=1), axis=1).max()
    arc = 360.0 if widest_gap < 1.5 * facet else 360 - np.degrees(widest_gap)
    point = centre @ across + (low + high) / 2 * direction
    direction = direction * np.sign(direction[np.argmax(np.abs(direction))])
    return CylindricalFace(faces, point, direction, radius, high - low, float(arc), bool(outward.mean() < 0))
