"""Rigid motions as 4x4 matrices, and small ones as twists: a rotation vector in rad, then a shift in mm."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import FloatArray


def turn_about(rotation: FloatArray, centre_mm: FloatArray, goes_to_mm: FloatArray) -> FloatArray:
    """Return the motion that turns by a (3, 3) rotation and carries a centre to where it goes.

    Examples
    --------
    >>> turn_about(np.diag([-1.0, -1.0, 1.0]), np.array([1.0, 0.0, 0.0]), np.array([1.0, 0.0, 0.5]))[:3, 3].tolist()
    [2.0, 0.0, 0.5]
    """
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = goes_to_mm - rotation @ centre_mm
    return matrix


def step_of(twist: FloatArray, centre_mm: FloatArray) -> FloatArray:
    """Return the motion that turns about a centre by a twist's rotation vector, then shifts."""
    from scipy.spatial.transform import Rotation

    return turn_about(Rotation.from_rotvec(twist[:3]).as_matrix(), centre_mm, centre_mm + twist[3:])


def flow_of(twist: FloatArray, centre_mm: FloatArray) -> FloatArray:
    """Return the motion reached by following a twist for unit time: about its own axis, which may miss the centre."""
    from scipy.linalg import expm

    generator = np.zeros((4, 4))
    generator[:3, :3] = np.cross(np.eye(3), twist[:3])
    generator[:3, 3] = twist[3:]
    to_centre, back = np.eye(4), np.eye(4)
    to_centre[:3, 3], back[:3, 3] = -centre_mm, centre_mm
    return np.asarray(back @ expm(generator) @ to_centre)


def displacement_metric(points_mm: FloatArray) -> FloatArray:
    """Return (6, 6) M so that ``twist @ M @ twist`` is the sum of the points' squared displacements.

    Parameters
    ----------
    points_mm
        (n, 3), relative to the centre that the twist turns about.
    """
    square = points_mm.T @ points_mm
    cross = np.cross(np.eye(3), points_mm.sum(axis=0))
    turning = np.trace(square) * np.eye(3) - square
    return np.block([[turning, cross], [cross.T, len(points_mm) * np.eye(3)]])
