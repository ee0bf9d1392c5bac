"""Diameters of a print where its reference has cylindrical faces."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.core.mesh import Mesh
from vialight.metrology.distance import Nearest, Samples, SurfaceTree, sample_surface
from vialight.metrology.round_faces import CylindricalFace, cylindrical_faces

_RIM_SHARE = 0.1
"""Of the height, left out at either end, where prints are rounded."""
_LEAST_POINTS = 30


@dataclass(frozen=True)
class Cylinder:
    """A cylindrical face of the reference, and what the print has there.

    Parameters
    ----------
    axis_point_mm, direction
        (3,) the middle of its axis and the unit vector along it, reference frame.
    height_mm, arc_deg
        How far it extends along and round its axis.
    is_hole
        Whether its faces look towards the axis.
    reference_diameter_mm, diameter_mm
        Of the reference and of the print; the latter None where the print has too little there.
    residual_rms_mm
        Of the print's vertices about the fitted cylinder.
    """

    axis_point_mm: tuple[float, float, float]
    direction: tuple[float, float, float]
    height_mm: float
    arc_deg: float
    is_hole: bool
    reference_diameter_mm: float
    diameter_mm: float | None
    residual_rms_mm: float | None


def measure_cylinders(measured: Mesh, reference: Mesh) -> tuple[Cylinder, ...]:
    """Fit the print's diameter at every cylindrical face of the reference.

    The print's vertices whose nearest point on the reference lies on the face, away from its ends, are fitted with a
    cylinder of their own axis and radius, each vertex weighing what its faces' area is.  Where a coarse mesh has no
    vertices between the ends, points spread over its faces serve.

    Parameters
    ----------
    measured
        The print, laid on the reference.
    reference
        What was meant.
    """
    found = cylindrical_faces(reference)
    if not found:
        return ()
    tree = SurfaceTree(reference)
    vertices = _Candidates.of(_vertices(measured), tree)
    results = [_measured(face, vertices) for face in found]
    if any(result.diameter_mm is None for result in results):
        spread = _Candidates.of(sample_surface(measured), tree)
        results = [
            _measured(face, spread) if result.diameter_mm is None else result
            for face, result in zip(found, results, strict=True)
        ]
    return tuple(results)


class _Candidates(NamedTuple):
    """Points of the print, and where they fall on the reference."""

    points_mm: FloatArray
    weights_mm2: FloatArray
    nearest: Nearest

    @classmethod
    def of(cls, samples: Samples, reference: SurfaceTree) -> _Candidates:
        weighs = samples.weights_mm2 > 0
        points = samples.points_mm[weighs]
        return cls(points, samples.weights_mm2[weighs], reference.nearest(points))

    def on(self, face: CylindricalFace) -> tuple[FloatArray, FloatArray]:
        along = (self.points_mm - face.point_mm) @ face.direction
        belongs = np.abs(along) < (0.5 - _RIM_SHARE) * face.height_mm
        belongs &= np.isin(self.nearest.face, face.faces)
        belongs &= self.nearest.distance_mm < face.radius_mm / 2
        return self.points_mm[belongs], self.weights_mm2[belongs]


def _vertices(mesh: Mesh) -> Samples:
    thirds = np.repeat(mesh.face_areas_mm2 / 3, 3)
    weights = np.bincount(mesh.faces.ravel(), weights=thirds, minlength=len(mesh.vertices_mm))
    return Samples(mesh.vertices_mm, weights.astype(np.float64))


def _measured(face: CylindricalFace, candidates: _Candidates) -> Cylinder:
    diameter, residual = None, None
    points, weights = candidates.on(face)
    if len(points) >= _LEAST_POINTS:
        diameter, residual = _fit_cylinder(points, weights, face)
    return Cylinder(
        axis_point_mm=_triple(face.point_mm),
        direction=_triple(face.direction),
        height_mm=face.height_mm,
        arc_deg=face.arc_deg,
        is_hole=face.is_hole,
        reference_diameter_mm=2 * face.radius_mm,
        diameter_mm=diameter,
        residual_rms_mm=residual,
    )


def _fit_cylinder(points: FloatArray, weights: FloatArray, face: CylindricalFace) -> tuple[float, float]:
    """Fit radius, place and tilt of a cylinder geometrically; return diameter and weighted RMS residual."""
    from scipy.optimize import least_squares

    across = np.linalg.svd(face.direction[None])[2][1:]
    root = np.sqrt(weights / weights.sum())
    local = points - face.point_mm

    def residual(parameters: FloatArray) -> FloatArray:
        shift, tilt, radius = parameters[:2], parameters[2:4], parameters[4]
        direction = face.direction + tilt @ across
        direction = direction / np.linalg.norm(direction)
        off = local - shift @ across
        return np.asarray(root * (np.linalg.norm(np.cross(off, direction), axis=1) - radius))

    found = least_squares(residual, np.r_[0, 0, 0, 0, face.radius_mm], x_scale=[1, 1, 0.1, 0.1, 1])
    return float(2 * found.x[4]), float(np.sqrt(2 * found.cost))


def _triple(values: FloatArray) -> tuple[float, float, float]:
    x, y, z = (round(float(value), 12) + 0.0 for value in values)
    return x, y, z
