"""Where a ray of the camera or projector runs inside the vial, in closed form.

Seen from above, a ray keeps ``n r sin(angle)`` at every surface concentric with the axis, and a cylinder keeps the
sine ``k`` of its elevation.  So the in-plane Snell's law holds in three dimensions with ``m = sqrt(n^2 - k^2)`` in
place of the index ``n``, and the straight line inside the resin follows without tracing anything.  The formulas are
those of ``docs/theory.md``, section "One ray"; the printed small-angle forms of Orth et al. 2022 (eqs. 5-9) are kept
as `small_angle_camera_to_virtual`, for comparison only.

Lengths are in mm, angles in rad.  ``x_c, z_c`` name a pixel by where its straight ray would cross the plane through the
rotation axis; ``x_v`` is the signed distance of the refracted ray from the axis.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from vialight.core.arrays import FloatArray
from vialight.core.config import Optics

_HEIGHT_ITERATIONS = 8
"""Each pass of `virtual_to_camera` gains a factor of about k^2 < 0.05, so that eight end at rounding."""

_TINY = 1e-300


class VirtualRays(NamedTuple):
    """Rays inside the resin, as parallel-beam tomography names them; NaN where the ray misses the resin."""

    virtual_x_mm: FloatArray
    """Signed distance from the axis, seen from above."""
    direction_rad: FloatArray
    """gamma: direction seen from above, from +y towards +x; the virtual angle is ``theta - beta + gamma``."""
    mid_height_mm: FloatArray
    """Height where the ray passes closest to the axis."""
    slope: FloatArray
    """Rise in mm per mm of the ray's plan view, away from the device."""


def camera_to_virtual(x_c_mm: ArrayLike, z_c_mm: ArrayLike, optics: Optics) -> VirtualRays:
    """Follow the rays of pixels into the resin.

    Parameters
    ----------
    x_c_mm, z_c_mm
        Where the pixels' straight rays cross the axis plane; any shapes that broadcast.
    optics
        The device and the vial.

    Returns
    -------
    VirtualRays
        Arrays of the broadcast shape; NaN where a ray misses the resin.

    Notes
    -----
    With ``phi = atan(x_c / D)``, ``b = D sin(phi)``, ``k = z_c / sqrt(D^2 + x_c^2 + z_c^2)``,
    ``m_j = sqrt(n_j^2 - k^2)`` and ``b_j = b m_a / m_j``::

        x_v   = b_r
        gamma = phi - asin(b/R) + asin(b_g/R) - asin(b_g/R_i) + asin(b_r/R_i)
        z_mid = k/m_a (D cos(phi) - sqrt(R^2 - b^2)) + k/m_g (sqrt(R^2 - b_g^2) - sqrt(R_i^2 - b_g^2))
                + k/m_r sqrt(R_i^2 - x_v^2)

    Examples
    --------
    >>> optics = Optics(12.4, 11.3, 1.472, 1.48, 190.0)
    >>> rays = camera_to_virtual(6.0, 0.0, optics)
    >>> round(float(rays.virtual_x_mm), 4), round(float(np.degrees(rays.direction_rad)), 3)
    (4.052, -8.053)
    """
    x_c, z_c = np.broadcast_arrays(np.asarray(x_c_mm, dtype=np.float64), np.asarray(z_c_mm, dtype=np.float64))
    distance = optics.distance_mm
    elevation_sine = z_c / distance / np.sqrt(1 + (x_c / distance) ** 2 + (z_c / distance) ** 2)
    height_at_axis = z_c / (1 + (x_c / distance) ** 2)
    impact = x_c / np.sqrt(1 + (x_c / distance) ** 2)
    plan = _plan_view(impact, elevation_sine, optics)
    mid_height = height_at_axis + elevation_sine * plan.height_per_elevation
    return VirtualRays(
        plan.virtual_x_mm, np.arctan(x_c / distance) + plan.bend_rad, mid_height, elevation_sine / plan.resin_index
    )


def virtual_to_camera(
    virtual_x_mm: ArrayLike, mid_height_mm: ArrayLike, optics: Optics
) -> tuple[FloatArray, FloatArray]:
    """Find the pixels that see given rays inside the resin; the inverse of `camera_to_virtual`.

    Parameters
    ----------
    virtual_x_mm, mid_height_mm
        Signed distance from the axis and height of closest approach; any shapes that broadcast.
    optics
        The device and the vial.

    Returns
    -------
    x_c_mm, z_c_mm : numpy.ndarray
        Where the pixels' straight rays cross the axis plane; NaN for rays that cannot leave the vial.

    Notes
    -----
    In the mid-plane ``b = n_r x_v`` and ``x_c = b / sqrt(1 - b^2/D^2)``.  Above it the elevation sine ``k`` is found by
    fixed-point iteration, as ``z_mid / k`` depends on ``k`` in second order only.

    Examples
    --------
    >>> optics = Optics(12.4, 11.3, 1.472, 1.48, 190.0)
    >>> x_c, z_c = virtual_to_camera(4.0, 7.0, optics)
    >>> rays = camera_to_virtual(x_c, z_c, optics)
    >>> round(float(rays.virtual_x_mm), 9), round(float(rays.mid_height_mm), 9)
    (4.0, 7.0)
    """
    x_v, z_mid = np.broadcast_arrays(
        np.asarray(virtual_x_mm, dtype=np.float64), np.asarray(mid_height_mm, dtype=np.float64)
    )
    elevation_sine = np.zeros(x_v.shape)
    for _ in range(_HEIGHT_ITERATIONS):
        m_air, m_resin = np.sqrt(1 - elevation_sine**2), np.sqrt(optics.resin_index**2 - elevation_sine**2)
        impact = x_v * m_resin / m_air
        elevation_sine, z_c = _raise(impact, z_mid, elevation_sine, optics)
    with np.errstate(invalid="ignore"):
        return impact / np.sqrt(1 - (impact / optics.distance_mm) ** 2), z_c


def height_to_camera(x_c_mm: ArrayLike, mid_height_mm: ArrayLike, optics: Optics) -> FloatArray:
    """Find where along a column of the image the rays of given mid-heights are seen.

    Parameters
    ----------
    x_c_mm, mid_height_mm
        Column and height of closest approach; any shapes that broadcast.
    optics
        The device and the vial.

    Returns
    -------
    numpy.ndarray
        z_c in mm; NaN for columns that miss the vial.

    Examples
    --------
    >>> optics = Optics(12.4, 11.3, 1.472, 1.48, 190.0)
    >>> z_c = height_to_camera(11.0, 7.0, optics)
    >>> round(float(camera_to_virtual(11.0, z_c, optics).mid_height_mm), 9)
    7.0
    """
    x_c, z_mid = np.broadcast_arrays(np.asarray(x_c_mm, dtype=np.float64), np.asarray(mid_height_mm, dtype=np.float64))
    impact = x_c / np.sqrt(1 + (x_c / optics.distance_mm) ** 2)
    elevation_sine, z_c = np.zeros(x_c.shape), z_mid
    for _ in range(_HEIGHT_ITERATIONS):
        elevation_sine, z_c = _raise(impact, z_mid, elevation_sine, optics)
    return z_c


def _raise(
    impact: FloatArray, mid_height: FloatArray, elevation_sine: FloatArray, optics: Optics
) -> tuple[FloatArray, FloatArray]:
    """Improve k, and z_c with it, for a given mid-height: both are proportional to it but for terms in k^2."""
    with np.errstate(invalid="ignore"):
        cosine = np.sqrt(1 - (impact / optics.distance_mm) ** 2)
        per_height = np.sqrt(1 - elevation_sine**2) / (cosine * optics.distance_mm)
        plan = _plan_view(impact, elevation_sine, optics)
        height_at_axis = mid_height / (1 + per_height * plan.height_per_elevation)
        return height_at_axis * per_height, height_at_axis / cosine**2


def transmission(x_c_mm: ArrayLike, z_c_mm: ArrayLike, optics: Optics) -> FloatArray:
    """Return the share of unpolarised light that gets from air into the resin, or out of it (Fresnel).

    Parameters
    ----------
    x_c_mm, z_c_mm
        Where the pixels' straight rays cross the axis plane; any shapes that broadcast.
    optics
        The device and the vial.

    Returns
    -------
    numpy.ndarray
        0 to 1; 0 where the ray misses the resin.

    Notes
    -----
    At a cylinder the sine of the angle of incidence in medium j is ``sqrt(1 - (1 - (k/n_j)^2) cos(a_j)^2)``, with
    ``sin(a_j) = b_j / r`` the angle seen from above.

    Examples
    --------
    >>> optics = Optics(12.4, 12.4, 1.5, 1.5, 150.0)
    >>> round(float(transmission(0.0, 0.0, optics)), 4)
    0.96
    """
    x_c, z_c = np.broadcast_arrays(np.asarray(x_c_mm, dtype=np.float64), np.asarray(z_c_mm, dtype=np.float64))
    distance = optics.distance_mm
    impact = x_c / np.sqrt(1 + (x_c / distance) ** 2)
    k = z_c / distance / np.sqrt(1 + (x_c / distance) ** 2 + (z_c / distance) ** 2)
    surfaces = [
        (optics.outer_radius_mm, 1.0, optics.wall_index),
        (optics.inner_radius_mm, optics.wall_index, optics.resin_index),
    ]
    if optics.outer_radius_mm == optics.inner_radius_mm:  # no glass
        surfaces = [(optics.outer_radius_mm, 1.0, optics.resin_index)]
    total = np.ones(x_c.shape)
    for radius, before, after in surfaces:
        # Cosines of incidence and refraction: of the angle seen from above times that of the climb.
        cosines = [
            np.sqrt(np.clip(1 - (impact / radius) ** 2 * (1 - k**2) / (n**2 - k**2), 0, 1)) * np.sqrt(1 - (k / n) ** 2)
            for n in (before, after)
        ]
        s_wave = (before * cosines[0] - after * cosines[1]) / (before * cosines[0] + after * cosines[1] + _TINY)
        p_wave = (before * cosines[1] - after * cosines[0]) / (before * cosines[1] + after * cosines[0] + _TINY)
        total = total * (1 - (s_wave**2 + p_wave**2) / 2)
    hits = np.isfinite(camera_to_virtual(x_c, z_c, optics).direction_rad)
    return np.where(hits, total, 0.0)


def small_angle_camera_to_virtual(x_c_mm: ArrayLike, optics: Optics) -> tuple[FloatArray, FloatArray]:
    """Follow rays by the printed mid-plane forms of Orth et al. 2022, eqs. 5-9, which approximate small angles.

    They ignore the glass (``n_2`` is the resin's index, the only radius the outer one) and take ``x_c / D`` for an
    angle and ``x_c*`` for ``x_c``.  For comparison with `camera_to_virtual`; nothing in vialight reconstructs with it.

    Returns
    -------
    virtual_x_mm, direction_rad : numpy.ndarray
        As in `VirtualRays`; the paper's ``theta_v - theta`` has the opposite sign of our ``gamma``.
    """
    x_c = np.asarray(x_c_mm, dtype=np.float64)
    radius, distance = optics.outer_radius_mm, optics.distance_mm
    with np.errstate(invalid="ignore", divide="ignore"):
        tangent = np.tan(x_c / distance)
        alpha = 1 + tangent**2
        pupil_ratio = np.where(x_c == 0, radius / distance, radius / x_c * tangent)
        x_hit = x_c * (1 - np.sqrt(1 - alpha * (1 - pupil_ratio**2))) / alpha
        transmission_angle = np.arcsin(x_hit / radius) + np.arctan(x_hit / distance)
        turn = np.arcsin(x_hit / radius) - np.arcsin(np.sin(transmission_angle) / optics.resin_index)
        return x_hit * np.cos(turn) - np.sqrt(radius**2 - x_hit**2) * np.sin(turn), -turn


class _PlanView(NamedTuple):
    """What the vial does to a ray seen from above."""

    virtual_x_mm: FloatArray
    bend_rad: FloatArray
    height_per_elevation: FloatArray
    """Change of the height of closest approach, in mm per unit of k, against the straight ray."""
    resin_index: FloatArray
    """m_r, the resin's index seen from above."""


def _plan_view(impact: FloatArray, elevation_sine: FloatArray, optics: Optics) -> _PlanView:
    outer, inner = optics.outer_radius_mm, optics.inner_radius_mm
    m_air = np.sqrt(1 - elevation_sine**2)
    m_wall = np.sqrt(optics.wall_index**2 - elevation_sine**2)
    m_resin = np.sqrt(optics.resin_index**2 - elevation_sine**2)
    in_wall = impact * m_air / m_wall
    in_resin = impact * m_air / m_resin
    with np.errstate(invalid="ignore"):
        bend = (
            -np.arcsin(impact / outer)
            + np.arcsin(in_wall / outer)
            - np.arcsin(in_wall / inner)
            + np.arcsin(in_resin / inner)
        )
        height_per_elevation = (
            -np.sqrt(outer**2 - impact**2) / m_air
            + (np.sqrt(outer**2 - in_wall**2) - np.sqrt(inner**2 - in_wall**2)) / m_wall
            + np.sqrt(inner**2 - in_resin**2) / m_resin
        )
    return _PlanView(in_resin, bend, height_per_elevation, m_resin)
