"""From projections in the resin to grey levels of a real projector."""

from __future__ import annotations

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, Float32Array, FloatArray, Grid
from vialight.config import Rig
from vialight.errors import InputError
from vialight.plan import Patterns
from vialight.projections.light import Light
from vialight.viewing import PixelRays, pixel_rays

TURN_RAD = 2 * np.pi
LEVELS = 255


def make_patterns(
    projections: Float32Array, light: Light, grid: Grid, rig: Rig, *, count: int | None = None
) -> Patterns:
    """Resample projections for the vial and the projector, and round them to grey levels.

    Each pixel, at each stage angle, sends light along one ray of the resin: the projection is read there, and divided
    by what the way takes from it: spreading by the vial's lens, reflection at the glass, absorption up to the point
    closest to the axis.  The brightest pixel of all gets level 255; nothing is clipped.

    Parameters
    ----------
    projections
        (psi, s, z) non-negative, of half a turn or a full one.
    light, grid
        Where they lie.
    rig
        With a projector and the resin's writing index.
    count
        Patterns in a turn; by default as many as projections.

    Raises
    ------
    InputError
        The rig lacks what writing needs, or all projections are dark.
    """
    projector, optics = rig.need_projector(), rig.writing_optics()
    sinogram = full_turn(projections) if light.geometry.from_both_sides else projections
    count = count or len(sinogram)
    rays = pixel_rays(
        projector.columns, projector.rows, projector.as_camera(), optics, rig.resin.absorption_per_mm or 0.0
    )
    rows, columns = _part_lit(rays, light, grid)
    angles = np.arange(count, dtype=np.float64) * (TURN_RAD / count)
    part = (slice(rows.start, rows.stop), slice(columns.start, columns.stop))
    irradiance = np.zeros((count, rows.stop - rows.start, columns.stop - columns.start), np.float32)
    _read(
        np.ascontiguousarray(sinogram), angles - np.radians(projector.azimuth_deg), rays.direction_rad[part],
        (rays.virtual_x_mm[part] - light.geometry.first_s_mm) / light.geometry.spacing_mm,
        (rays.mid_height_mm[part] - grid.z_mm[0]) / grid.voxel_mm,
        np.where(rays.delivery[part] > 0, 1 / np.maximum(rays.delivery[part], 1e-9), 0).astype(np.float32), irradiance,
    )  # fmt: skip
    brightest = float(irradiance.max())
    if brightest <= 0:
        raise InputError("projections", "are dark everywhere", accepted="some light", remedy="check part and target")
    irradiance *= np.float32(LEVELS / brightest)
    levels = np.rint(irradiance, out=irradiance).astype(np.uint8)
    return Patterns(levels, angles, rows.start, columns.start, brightest / LEVELS)


def full_turn(projections: Float32Array) -> Float32Array:
    """Return projections (psi, s, z) of a full turn from those of a half, ``p(psi + pi, s) = p(psi, -s)``."""
    return np.concatenate([projections, projections[:, ::-1]])


def _part_lit(rays: PixelRays, light: Light, grid: Grid) -> tuple[slice, slice]:
    """Return rows and columns of the image whose rays meet the projections."""
    half_width = -light.geometry.first_s_mm + light.geometry.spacing_mm / 2
    low, high = grid.z_mm[0] - grid.voxel_mm / 2, grid.z_mm[-1] + grid.voxel_mm / 2
    lit = (np.abs(rays.virtual_x_mm) <= half_width) & (rays.mid_height_mm >= low) & (rays.mid_height_mm <= high)
    if not lit.any():
        raise InputError("[projector]", "none of its pixels reaches the part", accepted="a projector that sees it")
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read(
    sinogram: Float32Array,
    theta: FloatArray,
    direction: FloatArray,
    strip: FloatArray,
    slice_: FloatArray,
    gain: Float32Array,
    out: Float32Array,
) -> None:
    """Read (psi, s, z) for every pixel at every stage angle: linear in angle and height, in the strip that it hits."""
    angles, samples, depth = sinogram.shape
    for k in prange(len(theta)):
        for r in range(out.shape[1]):
            for c in range(out.shape[2]):
                s, z = strip[r, c], slice_[r, c]
                if gain[r, c] == 0 or not (-0.5 <= s < samples - 0.5 and -0.5 <= z <= depth - 0.5):
                    continue
                turn = ((theta[k] + direction[r, c]) / TURN_RAD % 1.0) * angles
                a = int(turn)
                w = np.float32(turn - a)
                a, b = a % angles, (a + 1) % angles
                z = min(max(z, 0.0), depth - 1.0)
                low = min(int(z), max(depth - 2, 0))
                v = np.float32(z - low)
                high = min(low + 1, depth - 1)
                i = int(s + 0.5)
                near = (1 - w) * sinogram[a, i, low] + w * sinogram[b, i, low]
                far = (1 - w) * sinogram[a, i, high] + w * sinogram[b, i, high]
                out[k, r, c] = gain[r, c] * ((1 - v) * near + v * far)
