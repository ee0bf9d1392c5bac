"""From projections in the resin to grey levels of a real projector."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit, prange

from vialight.arrays import FAST_MATH, TURN_RAD, Float32Array, FloatArray, Grid
from vialight.config import Rig
from vialight.errors import InputError
from vialight.plan import Patterns
from vialight.projections.light import Light
from vialight.viewing import PixelRays, pixel_rays

LEVELS = 255


def make_patterns(
    projections: Float32Array, light: Light, grid: Grid, rig: Rig, *, count: int | None = None
) -> Patterns:
    """Resample projections for the vial and the projector, and round them to grey levels.

    Each pixel, at each stage angle, lights a patch of the resin: it gets the mean of the projection over that patch,
    strips and slices by the share that they have in it, divided by what the way takes: spreading by the vial's lens,
    reflection at the glass, absorption up to the point closest to the axis.  Between angles the projection is
    interpolated by Catmull-Rom's cubics; where they swing below 0 there is no light.  The brightest pixel of all gets
    level 255; nothing else is clipped.

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
    strips = _Footprints(
        (rays.virtual_x_mm[part] - light.geometry.first_s_mm) / light.geometry.spacing_mm,
        rays.width_mm[part] / light.geometry.spacing_mm,
    )
    slices = _Footprints(
        (rays.mid_height_mm[part] - grid.z_mm[0]) / grid.voxel_mm, rays.height_mm[part] / grid.voxel_mm
    )
    turned = angles - np.radians(projector.azimuth_deg) - light.geometry.psi_rad[0]
    _read(
        np.ascontiguousarray(sinogram), turned, rays.direction_rad[part],
        strips.start, strips.stop, slices.start, slices.stop,
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


class _Footprints(NamedTuple):
    """Where pixels' patches lie along one axis of the projections, which count by index from the edge of the first."""

    middle: FloatArray
    """In indices, whose wholes are the centres of samples."""
    width: FloatArray

    @property
    def start(self) -> FloatArray:
        return self.middle - self.width / 2 + 0.5

    @property
    def stop(self) -> FloatArray:
        return self.middle + self.width / 2 + 0.5


def _part_lit(rays: PixelRays, light: Light, grid: Grid) -> tuple[slice, slice]:
    """Return rows and columns of the image whose rays meet the projections."""
    half_width = -light.geometry.first_s_mm + (light.geometry.spacing_mm + rays.width_mm) / 2
    low, high = (grid.z_mm[end] + sign * (grid.voxel_mm + rays.height_mm) / 2 for end, sign in ((0, -1), (-1, 1)))
    lit = (np.abs(rays.virtual_x_mm) < half_width) & (rays.mid_height_mm > low) & (rays.mid_height_mm < high)
    if not lit.any():
        raise InputError("[projector]", "none of its pixels reaches the part", accepted="a projector that sees it")
    rows, columns = np.flatnonzero(lit.any(axis=1)), np.flatnonzero(lit.any(axis=0))
    return slice(int(rows[0]), int(rows[-1]) + 1), slice(int(columns[0]), int(columns[-1]) + 1)


@njit(parallel=True, fastmath=FAST_MATH, cache=True)
def _read(
    sinogram: Float32Array,
    theta: FloatArray,
    direction: FloatArray,
    first_strip: FloatArray,
    last_strip: FloatArray,
    first_slice: FloatArray,
    last_slice: FloatArray,
    gain: Float32Array,
    out: Float32Array,
) -> None:
    """Average (psi, s, z) over the patch of every pixel at every stage angle; outside it is dark."""
    angles, samples, depth = sinogram.shape
    for k in prange(len(theta)):
        for r in range(out.shape[1]):
            for c in range(out.shape[2]):
                if gain[r, c] == 0:
                    continue
                turn = ((theta[k] + direction[r, c]) / TURN_RAD % 1.0) * angles
                a = int(turn)
                w = turn - a
                w0, w3 = np.float32(-0.5 * w * (1 - w) ** 2), np.float32(-0.5 * w**2 * (1 - w))
                w1, w2 = np.float32(1 - w**2 * (2.5 - 1.5 * w)), np.float32(1 - (1 - w) ** 2 * (1 + 1.5 * w))
                before, here = sinogram[(a - 1) % angles], sinogram[a % angles]
                after, beyond = sinogram[(a + 1) % angles], sinogram[(a + 2) % angles]
                s0, s1, z0, z1 = first_strip[r, c], last_strip[r, c], first_slice[r, c], last_slice[r, c]
                total = np.float32(0)
                for i in range(max(int(np.floor(s0)), 0), min(int(np.ceil(s1)), samples)):
                    wide = min(s1, i + 1.0) - max(s0, i)
                    for z in range(max(int(np.floor(z0)), 0), min(int(np.ceil(z1)), depth)):
                        share = np.float32(wide * (min(z1, z + 1.0) - max(z0, z)))
                        total += share * (w0 * before[i, z] + w1 * here[i, z] + w2 * after[i, z] + w3 * beyond[i, z])
                if total > 0:
                    out[k, r, c] = gain[r, c] * total / np.float32((s1 - s0) * (z1 - z0))
