"""Which point of a projector's image lights a place in the resin, and by how much.

In the projector's frame this does not change while the vial turns, so that it is found once, on a lattice of the plan
view: for every place, Newton's method on traced rays finds the ray that passes through it; finite differences of
neighbouring rays give how far they have spread.  Nothing here knows how a vial refracts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit, prange

from vialight.core.arrays import FloatArray
from vialight.core.compiling import FAST_MATH
from vialight.core.config import Optics
from vialight.twin.rays import optics_array, trace_one

SHARE_OF_FIELD = 0.99
"""Of the field's radius: further out, rays graze the glass and places are reached by several rays or none."""

_LATTICE_MM = 0.125
_NEWTON_STEPS = 30
_DIFFERENCE_MM = 1e-4
_CONVERGED_MM = 1e-9


@dataclass(frozen=True)
class LightField:
    """Rays through places of the resin, as cubics in height on a lattice of the plan view.

    Parameters
    ----------
    coefficients
        (y, x, 3, 4) float64, projector's frame: x_c, z_c in mm and the share of irradiance, each as the coefficients
        of 1, z, z^2, z^3; NaN where no single ray passes.  The share is irradiance in the resin, across the ray, over
        that in air in the plane of the axis: spread, Fresnel transmission and absorption.
    lattice_mm
        Spacing of the lattice, whose middle is the axis.
    reach_mm
        Radius about the axis within which places are lit.
    """

    coefficients: FloatArray
    lattice_mm: float
    reach_mm: float


def light_field(
    optics: Optics,
    absorption_per_mm: float,
    *,
    height_mm: float = 10.0,
    pupil: tuple[float, float] = (0.0, 0.0),
    focus_mm: float = 0.0,
    lattice_mm: float = _LATTICE_MM,
) -> LightField:
    """Find the rays that light every place of the field.

    Parameters
    ----------
    optics
        The projector and the vial.
    absorption_per_mm
        Napierian, of the resin.
    height_mm
        Largest ``|z|`` from the projector's optical axis that is asked for.
    pupil, focus_mm
        See `vialight.twin.rays.trace`.
    lattice_mm
        Spacing of the lattice.

    Returns
    -------
    LightField
        For one point of the pupil.

    Examples
    --------
    >>> bare = light_field(Optics(10.0, 10.0, 1.0, 1.0, float("inf")), 0.0)  # no vial at all
    >>> middle = len(bare.coefficients) // 2
    >>> bare.coefficients[middle, middle].round(9) + 0.0
    array([[0., 0., 0., 0.],
           [0., 1., 0., 0.],
           [1., 0., 0., 0.]])
    """
    reach = SHARE_OF_FIELD * optics.field_radius_mm
    half = int(np.ceil(reach / lattice_mm)) + 1
    lattice = np.arange(-half, half + 1, dtype=np.float64) * lattice_mm
    nodes = np.array([-1.0, -0.4, 0.4, 1.0]) * max(height_mm, 1.0)
    found = np.full((len(lattice), len(lattice), 3, len(nodes)), np.nan)
    _solve(lattice, nodes, *pupil, focus_mm, absorption_per_mm, optics_array(optics), found)
    to_cubic = np.linalg.inv(np.vander(nodes, increasing=True))
    return LightField(found @ to_cubic.T, lattice_mm, reach)


@njit(fastmath=FAST_MATH, cache=True)
def _meet(
    x_c: float, z_c: float, y: float, right: float, up: float, focus: float, optics: FloatArray
) -> tuple[float, float, float, float, float]:
    """Return x and z where a ray crosses a plane of constant y, its path in the resin, its y-cosine, transmission."""
    ox, oy, oz, dx, dy, dz, transmission = trace_one(x_c, z_c, right, up, focus, optics)
    path = (y - oy) / dy
    return ox + path * dx, oz + path * dz, path, dy, transmission


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _solve(
    lattice: FloatArray, nodes: FloatArray, right: float, up: float, focus: float, absorption: float,
    optics: FloatArray, found: FloatArray,
) -> None:  # fmt: skip
    middle = len(lattice) // 2
    for iy in prange(len(lattice)):
        y = lattice[iy]
        for n in range(len(nodes)):
            for side in (-1, 1):
                # From the middle outwards, so that each solution is a guess for the next and no branch is jumped to.
                x_c, z_c, last = 0.0, nodes[n], 0.0
                for i in range(middle + 1):
                    ix = middle + side * i
                    guess = x_c + (x_c - last if i > 1 else 0.0)
                    last = x_c
                    x_c, z_c, share = _ray_through(
                        lattice[ix], y, nodes[n], guess, z_c, right, up, focus, absorption, optics
                    )
                    if np.isnan(share):
                        break
                    found[iy, ix, 0, n], found[iy, ix, 1, n], found[iy, ix, 2, n] = x_c, z_c, share


@njit(fastmath=FAST_MATH, cache=True)
def _ray_through(
    x: float, y: float, z: float, x_c: float, z_c: float, right: float, up: float, focus: float, absorption: float,
    optics: FloatArray,
) -> tuple[float, float, float]:  # fmt: skip
    """Return pixel position and share of irradiance of the ray through a place; NaN where none is found."""
    step_x, step_z = 0.0, 0.0
    d = _DIFFERENCE_MM
    for _ in range(_NEWTON_STEPS):
        hit_x, hit_z, path, cosine, transmission = _meet(x_c, z_c, y, right, up, focus, optics)
        if np.isnan(hit_x):  # beyond the field: half as far
            step_x, step_z = step_x / 2, step_z / 2
            x_c, z_c = x_c - step_x, z_c - step_z
            if abs(step_x) + abs(step_z) < _CONVERGED_MM:
                break
            continue
        xp, zp, _, _, _ = _meet(x_c + d, z_c, y, right, up, focus, optics)
        xm, zm, _, _, _ = _meet(x_c - d, z_c, y, right, up, focus, optics)
        xu, zu, _, _, _ = _meet(x_c, z_c + d, y, right, up, focus, optics)
        xd, zd, _, _, _ = _meet(x_c, z_c - d, y, right, up, focus, optics)
        xx, zx, xz, zz = (xp - xm) / (2 * d), (zp - zm) / (2 * d), (xu - xd) / (2 * d), (zu - zd) / (2 * d)
        spread = xx * zz - xz * zx
        if not spread > 0.0 or path < 0.0:
            break
        off_x, off_z = x - hit_x, z - hit_z
        if abs(off_x) + abs(off_z) < _CONVERGED_MM:
            return x_c, z_c, transmission * np.exp(-absorption * path) / (spread * cosine)
        step_x, step_z = (zz * off_x - xz * off_z) / spread, (xx * off_z - zx * off_x) / spread
        x_c, z_c = x_c + step_x, z_c + step_z
    return np.nan, np.nan, np.nan
