"""Rigid registration of a print to its reference, without scaling, and what the part's symmetry leaves open."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.mesh import Mesh
from vialight.metrology.distance import Samples, SurfaceTree, sample_surface
from vialight.metrology.rigid import displacement_metric, step_of, turn_about
from vialight.metrology.symmetry import open_twists, with_least_motion, words

_COARSE_POINTS = 800
_MIDDLE_POINTS = 8_000
_FINE_POINTS = 30_000
_STARTS_DEG = 22.0
_GOOD_ENOUGH = 1e-3
"""A start that ends this close, as a share of the largest dimension, is not going to be beaten."""
_DAMPING = 1e-4


@dataclass(frozen=True)
class Registration:
    """The rigid motion that lays a print on its reference.

    Parameters
    ----------
    matrix
        (4, 4): ``reference_point = matrix @ print_point``, mm, object frame.
    open_directions
        In words, the motions that the part's symmetry leaves open; along these the print has not been moved.
    """

    matrix: FloatArray
    open_directions: tuple[str, ...]

    @property
    def rotation_vector_deg(self) -> FloatArray:
        """(3,) axis times angle."""
        from scipy.spatial.transform import Rotation

        return np.asarray(np.degrees(Rotation.from_matrix(self.matrix[:3, :3]).as_rotvec()))

    @property
    def angle_deg(self) -> float:
        """The angle turned."""
        return float(np.linalg.norm(self.rotation_vector_deg))

    @property
    def translation_mm(self) -> FloatArray:
        """(3,) the shift that follows the rotation about the origin."""
        return np.asarray(self.matrix[:3, 3])


def register(measured: Mesh, reference: Mesh) -> Registration:
    """Find the rigid motion of a print that brings its surface closest to the reference's, in the mean square.

    Gauss-Newton on the exact distances to the reference's triangles, over points spread evenly on the print: so what
    is made least is the RMSE that is reported.  A few hundred points find the place, from several starts (as placed,
    centroid on centroid, and turned by 22 deg about each axis); more points refine it until steps fall below 10 nm.
    The starts reach prints that lie up to 30 deg and several mm off.

    Directions that the reference's symmetry leaves open (see `symmetry.open_twists`) are named, and the print is left
    as it lies along them.

    Parameters
    ----------
    measured
        The print.
    reference
        What was meant; it need not be closed.
    """
    points = _spread(measured, _FINE_POINTS)
    target = _Target(reference)
    rng = np.random.default_rng(0)
    coarse, middle = (points[rng.permutation(len(points))[:count]] for count in (_COARSE_POINTS, _MIDDLE_POINTS))
    start = _best_start(coarse, target)
    pose = _descend(middle, target, start, iterations=40)
    twists = open_twists(*target.smooth(pose.apply(middle)))
    matrix = with_least_motion(pose.matrix, twists, target.centre_mm, target.size_mm)
    pose = _descend(points, target, PrintPose(matrix), iterations=12, held=twists)
    matrix = with_least_motion(pose.matrix, twists, target.centre_mm, target.size_mm)
    return Registration(matrix, words(twists, target.centre_mm, target.size_mm))


class PrintPose(NamedTuple):
    """A rigid motion."""

    matrix: FloatArray
    """(4, 4)."""
    rms_mm: float = np.inf
    """What it leaves, where that is known."""

    def apply(self, points_mm: FloatArray) -> FloatArray:
        """Move (n, 3) points."""
        return np.asarray(points_mm @ self.matrix[:3, :3].T + self.matrix[:3, 3])


class Pairs(NamedTuple):
    """Points, and the surface next to each."""

    centred_mm: FloatArray
    """(n, 3) points relative to the reference's centre."""
    normals: FloatArray
    """(n, 3) directions in which a motion changes the distance."""
    gap_mm: FloatArray
    """(n,) distances along the normals."""


class _Target:
    """The reference, ready to be asked."""

    def __init__(self, mesh: Mesh) -> None:
        import igl

        self.tree = SurfaceTree(mesh)
        self.normals = mesh.face_normals
        samples = _spread(mesh, _MIDDLE_POINTS)
        self.centre_mm = samples.mean(axis=0)
        self.size_mm = float(np.sqrt(((samples - self.centre_mm) ** 2).sum(axis=1).mean()))
        # Facets that meet at less than 30 deg are taken for one smooth face: a cylinder is round, not a prism.
        corners = igl.per_corner_normals(mesh.vertices_mm, mesh.faces, 30.0)
        self.corner_normals = np.nan_to_num(np.asarray(corners).reshape(-1, 3, 3))

    def gaps(self, points_mm: FloatArray) -> Pairs:
        """Pair points with the exact direction of their distance, and with the face's normal where that vanishes."""
        near = self.tree.nearest(points_mm)
        offset = points_mm - near.point_mm
        normals = self.normals[near.face]
        gap = np.einsum("ij,ij->i", offset, normals)
        is_far = near.distance_mm > 1e-6 * self.size_mm
        normals[is_far] = offset[is_far] / near.distance_mm[is_far, None]
        gap[is_far] = near.distance_mm[is_far]
        return Pairs(points_mm - self.centre_mm, normals, gap)

    def smooth(self, points_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the nearest points on the reference, centred, and the smooth normals there."""
        near = self.tree.nearest(points_mm)
        shares = _barycentric(near.point_mm, self.tree.mesh.corners_mm[near.face])
        normals = np.einsum("ij,ijk->ik", shares, self.corner_normals[near.face])
        lengths = np.linalg.norm(normals, axis=1, keepdims=True)
        normals = np.divide(normals, lengths, out=np.zeros_like(normals), where=lengths > 0)
        return near.point_mm - self.centre_mm, normals


def _best_start(points: FloatArray, target: _Target) -> PrintPose:
    from scipy.spatial.transform import Rotation

    centroid = points.mean(axis=0)
    axes = np.vstack([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
    turns = Rotation.from_rotvec(_STARTS_DEG * axes, degrees=True).as_matrix()
    starts = [np.eye(4), *(turn_about(turn, centroid, target.centre_mm) for turn in turns)]
    best = PrintPose(starts[0])
    for start in starts:
        found = _descend(points, target, PrintPose(start), iterations=50)
        # A later start, with more motion, has to be better by more than chance.
        if found.rms_mm < 0.98 * best.rms_mm:
            best = found
        if best.rms_mm < _GOOD_ENOUGH * target.size_mm:
            break
    return best


def _descend(
    points: FloatArray, target: _Target, pose: PrintPose, iterations: int, held: FloatArray | None = None
) -> PrintPose:
    """Take damped Gauss-Newton steps until they fall below 10 nm; return the best pose met."""
    best = PrintPose(pose.matrix)
    for _ in range(iterations):
        pairs = target.gaps(pose.apply(points))
        rms = float(np.sqrt(np.mean(pairs.gap_mm**2)))
        if rms < best.rms_mm:
            best = PrintPose(pose.matrix, rms)
        twist = _step(pairs, held)
        pose = PrintPose(step_of(twist, target.centre_mm) @ pose.matrix)
        if np.abs(twist[:3]).max() * target.size_mm + np.abs(twist[3:]).max() < 1e-5:
            break
    last = target.gaps(pose.apply(points)).gap_mm
    rms = float(np.sqrt(np.mean(last**2)))
    return PrintPose(pose.matrix, rms) if rms <= best.rms_mm else best


def _step(pairs: Pairs, held: FloatArray | None) -> FloatArray:
    """Solve for the twist (rotation vector, shift) about the reference's centre that closes the gaps.

    The damping is in proportion to how far a twist moves the points: motions that hardly change any distance, which
    symmetry leaves open, are hardly made.
    """
    rows = np.hstack([np.cross(pairs.centred_mm, pairs.normals), pairs.normals])
    information, mobility = rows.T @ rows, displacement_metric(pairs.centred_mm)
    damped = information + _DAMPING * mobility
    gradient = rows.T @ pairs.gap_mm
    if held is None or not len(held):
        return np.asarray(np.linalg.solve(damped, -gradient))
    # Steps that are orthogonal, in the mobility, to what is held.
    free = np.linalg.svd(held @ mobility)[2][len(held) :]
    return np.asarray(free.T @ np.linalg.solve(free @ damped @ free.T, -free @ gradient))


def _spread(mesh: Mesh, count: int) -> FloatArray:
    samples: Samples = sample_surface(mesh, count)
    return samples.points_mm[samples.weights_mm2 > 0]


def _barycentric(points: FloatArray, corners: FloatArray) -> FloatArray:
    """Return (n, 3) shares of the corners that make points within their triangles."""
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    squared = np.maximum((across**2).sum(axis=1), np.finfo(float).tiny)
    opposite = np.roll(corners, -2, axis=1) - np.roll(corners, -1, axis=1)
    from_edge = points[:, None] - np.roll(corners, -1, axis=1)
    return np.asarray(np.einsum("ijk,ik->ij", np.cross(opposite, from_edge), across) / squared[:, None])
