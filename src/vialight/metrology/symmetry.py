"""Which rigid motions leave a surface on itself, so that no measurement can tell how far they went."""

from __future__ import annotations

import numpy as np

from vialight.core.arrays import FloatArray
from vialight.metrology.rigid import displacement_metric, flow_of

_OPEN_BELOW = 1e-3
"""Motions that change distances by less than 3 % (the root) of what they displace points are called open."""
_FAR_OUT = 100
_SAME_DIRECTION = np.cos(np.radians(1.0))


def open_twists(points_mm: FloatArray, normals: FloatArray) -> FloatArray:
    """Find the motions along which a surface slides on itself.

    The point-to-plane information matrix ``H = sum j j'`` with ``j = (p x n, n)`` tells how much a twist changes the
    distances; ``M`` (see `rigid.displacement_metric`) tells how much it displaces the points.  The eigenvalues of
    ``H t = mu M t`` are shares from 0 to 1 that depend neither on units nor on the part's size: 0 for a motion that
    slides the surface on itself.

    Parameters
    ----------
    points_mm
        (n, 3), spread evenly on the surface, relative to any centre.
    normals
        (n, 3), smooth over facets that stand for one curved face.

    Returns
    -------
    numpy.ndarray
        (k, 6) twists about that centre: none for a part without such symmetry, three for a sphere.
    """
    from scipy.linalg import eigh

    rows = np.hstack([np.cross(points_mm, normals), normals])
    shares, twists = eigh(rows.T @ rows, displacement_metric(points_mm))
    return np.asarray(twists.T[shares < _OPEN_BELOW])


def with_least_motion(matrix: FloatArray, twists: FloatArray, centre_mm: FloatArray, size_mm: float) -> FloatArray:
    """Follow the open directions from a found motion to where the part is displaced least.

    Parameters
    ----------
    matrix
        (4, 4) motion that lays the print on the reference.
    twists
        (k, 6) open directions about `centre_mm`.
    size_mm
        How large the part is.

    Returns
    -------
    numpy.ndarray
        (4, 4) motion that fits as well, and turns and shifts no more than it has to.
    """
    from scipy.optimize import least_squares

    if not len(twists):
        return matrix
    # Points about the print's own centre, where turning and shifting do not mix, and far out, so that turning counts
    # more than that centre's uncertainty.
    own_centre = matrix[:3, :3].T @ (centre_mm - matrix[:3, 3])
    corners = own_centre + _FAR_OUT * size_mm * np.vstack([np.eye(3), -np.eye(3)])
    # Displacements of the order of the part for parameters of order 1.
    scaled = twists / np.linalg.norm(twists * np.repeat([1.0, 1 / size_mm], 3), axis=1, keepdims=True)

    def followed(amounts: FloatArray) -> FloatArray:
        return flow_of(amounts @ scaled, centre_mm) @ matrix

    def displacement(amounts: FloatArray) -> FloatArray:
        moved = followed(amounts)
        return np.asarray((corners @ moved[:3, :3].T + moved[:3, 3] - corners).ravel())

    found = least_squares(displacement, np.zeros(len(scaled)), xtol=1e-12, ftol=1e-15, gtol=1e-12)
    return followed(found.x)


def words(twists: FloatArray, centre_mm: FloatArray, size_mm: float) -> tuple[str, ...]:
    """Name open directions: rotations and shifts about and along the object frame's axes where they are that.

    Examples
    --------
    >>> words(np.array([[0, 0, 0.3, 0, 0, 0]]), np.array([0.0, 0, 2]), 5.0)
    ('rotation about z',)
    >>> words(np.array([[0, 0.1, 0, 0, 0, 0], [0, 0, 0, 0, 2, 0]]), np.array([0.0, 0, 2]), 5.0)
    ('rotation about y through (0.00, 0.00, 2.00) mm', 'shift along y')
    """
    if not len(twists):
        return ()
    scaled = twists * np.repeat([size_mm, 1.0], 3)
    scaled = scaled / np.linalg.norm(scaled, axis=1, keepdims=True)
    mixing, strengths, _ = np.linalg.svd(scaled[:, :3])
    turns = int(np.count_nonzero(strengths > 1e-2))
    shifts = (mixing[:, turns:].T @ scaled)[:, 3:]
    turning = mixing[:, :turns].T @ scaled
    return (
        *(_rotation_words(axis, turning, centre_mm, size_mm) for axis in _readable_directions(turning[:, :3])),
        *(f"shift along {_direction_words(axis)}" for axis in _readable_directions(shifts)),
    )


def _rotation_words(axis: FloatArray, turning: FloatArray, centre_mm: FloatArray, size_mm: float) -> str:
    mix = np.linalg.lstsq(turning[:, :3].T, axis, rcond=None)[0]
    shift = (mix @ turning)[3:] * size_mm  # mm per rad, about the centre
    through = centre_mm + np.cross(axis, shift)
    through = through - axis * (axis @ through)  # of the axis, the point nearest to the origin
    rise = float(axis @ shift) * 2 * np.pi
    text = f"rotation about {_direction_words(axis)}"
    if np.linalg.norm(through) > 1e-2 * size_mm:
        text += " through (" + ", ".join(f"{value + 0.0:.2f}" for value in through.round(2)) + ") mm"
    return text if abs(rise) < 1e-1 * size_mm else f"{text}, rising {rise:.2f} mm a turn"


def _readable_directions(vectors: FloatArray) -> list[FloatArray]:
    """Return orthonormal directions that span the same space, coordinate axes first."""
    if not len(vectors):
        return []
    basis = np.linalg.svd(vectors, full_matrices=False)[2]
    chosen: list[FloatArray] = [axis for axis in np.eye(3) if np.linalg.norm(basis @ axis) > _SAME_DIRECTION]
    for direction in basis:
        rest = direction - sum((axis * (axis @ direction) for axis in chosen), np.zeros(3))
        if len(chosen) < len(basis) and np.linalg.norm(rest) > 0.1:
            chosen.append(rest / np.linalg.norm(rest))
    return chosen


def _direction_words(axis: FloatArray) -> str:
    for name, unit in zip("xyz", np.eye(3), strict=True):
        if abs(axis @ unit) > _SAME_DIRECTION:
            return name
    towards = axis * np.sign(axis[np.argmax(np.abs(axis))])
    return "(" + ", ".join(f"{value + 0.0:.2f}" for value in towards.round(2)) + ")"
