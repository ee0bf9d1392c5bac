"""Where a projector stands, from the glow of vertical lines of light that a camera sees across.

Each line is a sheet of light in the resin, bent by the vial.  The photoinitiator glows where it passes; a camera's ray
crosses it once, and sees more of it the more slantwise it does, and less the further the light has come through the
absorbing resin.  So brightness along the image tells where the sheet lies and from which side it comes: a projector on
the wrong side would print a mirrored part.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from vialight.core.arrays import BoolArray, FloatArray
from vialight.core.config import Camera, Optics, Projector
from vialight.core.errors import InputError
from vialight.optics.refraction import VirtualRays, camera_to_virtual, transmission

SEEN_SHARE = 0.9
"""Of the field's radius: what is fitted lies within, so that the vial's edge, where rays graze the glass, is not."""
LEAST_SNR = 5.0
"""Of a line's brightness over the noise of the columns."""
_SLANT = 0.15
"""Least sine between a line's sheet and a ray of the camera: nearly along it, it is as bright as it is thin."""
_SMALL_MM = 0.01
_PLACES = 4
"""Across a line, at which its sheet is computed."""
_STEPS = 30


@dataclass(frozen=True)
class Sweep:
    """What a camera saw of vertical lines, one after the other.

    Parameters
    ----------
    counts
        (line, column) above the background, mean of rows near the optical one.
    first_columns
        (line,) of the projector, where each line begins.
    width_columns
        Of a line.
    """

    counts: FloatArray
    first_columns: FloatArray
    width_columns: int


@dataclass(frozen=True)
class ProjectorFit:
    """What a sweep tells of a projector.

    Parameters
    ----------
    axis_column, pixel_mm, azimuth_deg, absorption_per_mm
        As found.
    stds
        Their standard uncertainties, from how much lines disagree.
    other_side
        By which factor the squares are larger with the projector on the other side of the camera.
    seen, expected
        (line, column) counts; NaN where they were not compared.
    """

    axis_column: float
    pixel_mm: float
    azimuth_deg: float
    absorption_per_mm: float
    stds: FloatArray
    other_side: float
    seen: FloatArray
    expected: FloatArray


def line_columns(projector: Projector, optics: Optics, lines: int, width_columns: int) -> FloatArray:
    """Return the first columns of lines that share the field evenly, as the rig has it, a little within its edges."""
    edge = 0.88 * optics.outer_radius_mm / projector.pixel_mm
    middles = projector.axis_column + np.linspace(-edge, edge, lines)
    inside = np.clip(middles - (width_columns - 1) / 2, 0, projector.columns - width_columns)
    return np.unique(np.rint(inside))


def fit_projector(
    sweep: Sweep, camera: Camera, seen_through: Optics, projector: Projector, lit_through: Optics,
    absorption_per_mm: float, where: object = "",
) -> ProjectorFit:  # fmt: skip
    """Fit a projector's axis column, pixel and azimuth, and the resin's absorption, to a sweep.

    Both sides of the camera are tried, whatever the rig says.

    Parameters
    ----------
    sweep
        What was seen.
    camera, seen_through
        The camera, and what its rays pass through.
    projector, lit_through
        As the rig has it: within half a field and 10 deg of the truth, or of its mirror image.
    absorption_per_mm
        To start from.
    where
        Named in errors.

    Raises
    ------
    InputError
        No line is seen.
    """
    noise = float(np.median(np.abs(np.diff(sweep.counts, axis=1)))) / 0.6745 / np.sqrt(2) + 1e-9
    brightest = np.percentile(sweep.counts, 98, axis=1)
    lit = brightest > LEAST_SNR * noise
    if lit.sum() < 5:
        raise InputError(
            where, f"{lit.sum()} of {len(lit)} lines glow by more than {LEAST_SNR:g} times the noise of {noise:.3g}",
            accepted="5 lines and more", remedy="take the camera's filter off, or expose for longer",
        )  # fmt: skip
    x_c = (np.arange(sweep.counts.shape[1]) - camera.axis_column) * camera.pixel_mm
    seen = camera_to_virtual(x_c, 0.0, seen_through)
    fits = []
    for side in (1, -1):
        start = np.array([projector.axis_column, projector.pixel_mm, np.radians(side * projector.azimuth_deg),
                          absorption_per_mm, 0.0])  # fmt: skip
        fits.append(_fit(start, sweep, lit, seen, lit_through))
    best, other = sorted(fits, key=lambda fit: fit[0])
    cost, values, stds, kept, expected = best
    azimuth = float((np.degrees(values[2]) + 180) % 360 - 180)
    return ProjectorFit(
        float(values[0]), float(values[1]), azimuth, float(values[3]),
        stds[:4] * [1, 1, np.degrees(1), 1], float(other[0] / cost),
        np.where(kept, sweep.counts, np.nan), np.where(kept, expected, np.nan),
    )  # fmt: skip


_Fit = tuple[float, FloatArray, FloatArray, BoolArray, FloatArray]


def _fit(start: FloatArray, sweep: Sweep, lit: BoolArray, seen: VirtualRays, optics: Optics) -> _Fit:
    """Return mean square, values, uncertainties, what was compared, and what was expected."""
    unit = np.array([1.0, 1e-3 * start[1], np.radians(0.1), 0.01, 0.1])
    scale = float(np.percentile(sweep.counts[lit], 90))
    values, kept, root = start, np.zeros(sweep.counts.shape, bool), np.sqrt(np.maximum(sweep.counts, 0.02 * scale))
    for _ in range(3):
        _, inside = _expected(values, sweep, seen, optics)
        kept = inside & lit[:, None]
        if values is start:  # the brightness that suits
            shape = _expected(start, sweep, seen, optics)[0]
            values = start.copy()
            values[4] = np.log(max(float(np.nanmedian(sweep.counts[kept] / shape[kept])), 1e-12))
        base, compared = values, kept

        def off(step: FloatArray, base: FloatArray = base, compared: BoolArray = compared) -> FloatArray:
            expected, _ = _expected(base + step * unit, sweep, seen, optics)
            return np.asarray(((np.nan_to_num(expected) - sweep.counts) / root)[compared])

        found = least_squares(off, np.zeros(5), loss="soft_l1", max_nfev=_STEPS,
                              f_scale=3 * _spread(off(np.zeros(5))))  # fmt: skip
        values = values + found.x * unit
    residual = off(found.x)
    jacobian = np.asarray(found.jac, dtype=np.float64)
    inverse = np.linalg.pinv(jacobian.T @ jacobian)
    # What is wrong with a line is wrong with all of it: lines, not pixels, are taken as independent.
    line = np.nonzero(kept)[0]
    pulls = np.array([jacobian[line == k].T @ residual[line == k] for k in np.unique(line)])
    covariance = inverse @ (pulls.T @ pulls) @ inverse * len(pulls) / max(len(pulls) - 5, 1)
    expected, _ = _expected(values, sweep, seen, optics)
    return float(np.mean(residual**2)), values, np.sqrt(np.diag(covariance)) * unit, kept, expected


def _spread(values: FloatArray) -> float:
    return float(np.median(np.abs(values))) + 1e-12


def _expected(values: FloatArray, sweep: Sweep, seen: VirtualRays, optics: Optics) -> tuple[FloatArray, BoolArray]:
    """Return (line, column) counts, and where rays meet the light well within the field."""
    axis_column, pixel_mm, azimuth, absorption, log_brightness = values
    total, inside = np.zeros(sweep.counts.shape), np.ones(sweep.counts.shape, bool)
    middles = sweep.first_columns + (sweep.width_columns - 1) / 2
    for place, share in zip(*np.polynomial.legendre.leggauss(_PLACES), strict=True):
        x_p = ((middles + place * sweep.width_columns / 2 - axis_column) * pixel_mm)[:, None]
        part, met = _glow_of_sheet(x_p, azimuth, absorption, seen, optics)
        total, inside = total + share / 2 * part, inside & met
    return np.exp(log_brightness) * total, inside


def _glow_of_sheet(
    x_p: FloatArray, azimuth: float, absorption: float, seen: VirtualRays, optics: Optics
) -> tuple[FloatArray, BoolArray]:
    """Return what rays see of the sheets of light of single columns.

    The sheet is the line ``x cos(a) - y sin(a) = v`` with ``a = gamma - azimuth``, lit along ``(sin(a), cos(a))``;
    a ray of direction ``c`` at ``u`` crosses it ``s = (u - v cos(a - c)) / sin(a - c)`` from its middle.
    """
    light = camera_to_virtual(x_p, _SMALL_MM, optics)
    across, along = light.virtual_x_mm, light.direction_rad - azimuth
    turned = along - seen.direction_rad
    with np.errstate(invalid="ignore", divide="ignore"):
        s = (seen.virtual_x_mm - across * np.cos(turned)) / np.sin(turned)
        path = s + np.sqrt(optics.inner_radius_mm**2 - across**2)
        height = (light.mid_height_mm + s * light.slope) / _SMALL_MM
        faded = np.exp(-absorption * np.clip(path, 0, 2 * optics.outer_radius_mm))
        glow = transmission(x_p, 0.0, optics) * faded / ((np.abs(np.sin(turned)) + 1e-9) * height)
        away = np.hypot(across, s)
    reached = (away < SEEN_SHARE * optics.field_radius_mm) & (np.abs(np.sin(turned)) > _SLANT)
    return np.asarray(glow), np.asarray(np.isfinite(glow) & reached)
