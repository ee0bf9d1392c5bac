"""Opposite views: every ray is seen again, from the other side, half a turn and twice its bend later.

The ray of a pixel at stage angle theta, ``x_c`` beside the axis, comes back at ``theta + pi + 2 gamma(x_c)`` and
``-x_c``: p(psi, s) = p(psi + pi, -s).  Where axis, tilt, run-out or bend are wrong, the two differ; `fit` changes them
until they differ least.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from vialight.calibration.opposite_sums import AXIS, DRIFT, OUT_X, OUT_Y, TILT, add_up, read_between
from vialight.core.arrays import Float32Array, FloatArray
from vialight.core.config import Camera, Optics
from vialight.optics.refraction import camera_to_virtual

PRIOR = np.array([4.0, np.radians(2.0), 0.5, 0.5, 0.3])
"""Spans that axis (columns), tilt, run-out (mm along x and y) and drift of the light (a turn) are expected in."""

FIRST_LOOK, LAST_LOOK = 4.0, 1.2
"""Columns: standard deviations by which frames are smoothed, so that interpolation sees no pixels."""

SMOOTHING_ROWS, ROW_STEP, ROWS_A_BLOCK = 1.0, 2, 4
"""Rows: as above; between those compared; that count as one where it is asked how far noise scatters the result."""

SECTORS = 36
"""Of a turn, whose misfits are taken to be independent of each other."""

SHARE_OF_VIAL = 0.9
"""Of its radius within which rays are compared: beyond it the edges' stray light moves."""

_NOISE_LEFT = 0.2
"""Of a pixel's noise, in the difference of two smoothed views."""

_PASSES = 12
_SETTLED = 0.03
"""Of a standard uncertainty; a pass that changes less is the last."""


@dataclass(frozen=True)
class Views:
    """Frames of one turn, made ready to be compared.

    Parameters
    ----------
    counts
        (frame, row, column) above the background.
    angles_rad
        (frame,) ascending in [0, 2 pi), counter-clockwise seen from above.
    time
        (frame,) place in the turn by time, -1/2 to 1/2.
    first_row
        Of the image, that the counts begin with.
    camera, optics
        As the rig has them; no optics for data without a vial.
    row_step
        Rows between those compared.
    """

    counts: Float32Array
    angles_rad: FloatArray
    time: FloatArray
    first_row: int
    camera: Camera
    optics: Optics | None
    row_step: int = ROW_STEP

    @property
    def x_c_mm(self) -> FloatArray:
        """(x,) places beside the axis that are compared with their opposites."""
        columns, axis, pixel = self.counts.shape[2], self.camera.axis_column, self.camera.pixel_mm
        reach = min(axis, columns - 1 - axis)
        if self.optics is not None:
            edge = SHARE_OF_VIAL * self.optics.outer_radius_mm
            reach = min(reach, edge / np.sqrt(1 - (edge / self.optics.distance_mm) ** 2) / pixel)
        return np.asarray((np.arange(max(int(reach), 1)) + 0.5) * pixel, dtype=np.float64)

    @property
    def z_c_mm(self) -> FloatArray:
        """(z,) heights that are compared: every other row, but for those near either end."""
        rows = self.first_row + np.arange(3, self.counts.shape[1] - 3, self.row_step)
        return np.asarray((self.camera.optical_row - rows) * self.camera.pixel_mm, dtype=np.float64)


@dataclass(frozen=True)
class ViewComparison:
    """Rays and their opposites, for one set of parameters.

    Parameters
    ----------
    normal, gradient
        (z, p, p), (z, frame, p): J'J and J'r of the differences.
    differences, by_angle
        (frame, x, z) and (2, frame, x, z): of each ray less its opposite, and both's derivative by angle.
    weights
        (frame, x, z) of the differences: less than 1 where the two rays climb past an edge of the part.
    gamma_rad
        (x, z) of the rays.
    """

    normal: FloatArray
    gradient: FloatArray
    differences: Float32Array
    by_angle: Float32Array
    weights: Float32Array
    gamma_rad: FloatArray

    @property
    def rms(self) -> float:
        """Of the differences by their weights, counts."""
        squares = np.nan_to_num(self.differences.astype(np.float64)) ** 2
        return float(np.sqrt((self.weights * squares).sum() / max(float(self.weights.sum(dtype=np.float64)), 1e-30)))


@dataclass(frozen=True)
class Fit:
    """Parameters with which rays and their opposites agree best.

    Parameters
    ----------
    parameters
        (5 + k,) axis column, tilt (rad), run-out x, y (mm, object frame), drift of the light, and what else was asked.
    covariance
        Of the parameters.
    comparison
        With these parameters.
    """

    parameters: FloatArray
    covariance: FloatArray
    comparison: ViewComparison

    @property
    def std(self) -> FloatArray:
        """Standard uncertainties."""
        return np.sqrt(np.diag(self.covariance))


def smoothed_splines(views: Views, columns: float, *, among_frames: bool = True) -> Float32Array:
    """Return cubic B-spline coefficients, along rows and columns, of smoothed frames.

    Neighbouring columns are smoothed at one direction in the resin, for which frames are smoothed too.  At one stage
    angle the kernel would lie askew in the sinogram, to one side in a view and to the other in its opposite.

    Parameters
    ----------
    views
        The frames.
    columns
        Standard deviation of the kernel.
    among_frames
        Whether to; else every frame stays by itself.
    """
    bend = _bend_of_columns(views)
    smooth = ndimage.gaussian_filter1d(views.counts, SMOOTHING_ROWS, axis=1, mode="nearest")
    if among_frames:
        smooth = read_between(smooth, views.angles_rad, views.angles_rad, bend)
    smooth = ndimage.gaussian_filter1d(smooth, columns, axis=2, mode="nearest")
    if among_frames:
        smooth = read_between(smooth, views.angles_rad, views.angles_rad, -bend)
    for axis in (1, 2):
        smooth = ndimage.spline_filter1d(smooth, 3, axis=axis, mode="mirror", output=np.float32)
    return smooth


def _bend_of_columns(views: Views) -> FloatArray:
    if views.optics is None:
        return np.zeros(views.counts.shape[2])
    column = np.arange(views.counts.shape[2], dtype=np.float64)
    x_c = (column - views.camera.axis_column) * views.camera.pixel_mm
    bend = _gamma(x_c, np.zeros(1), views.optics)[:, 0]
    seen = np.flatnonzero(np.isfinite(bend))
    return np.interp(column, seen, bend[seen])


def compare(
    views: Views, coefficients: Float32Array, parameters: FloatArray, slopes: FloatArray | None = None
) -> ViewComparison:
    """Compare every ray with its opposite.

    Parameters
    ----------
    views
        Where the rays are seen; their camera's and optics' own values are what `parameters` do not say.
    coefficients
        See `smoothed_splines`.
    parameters
        See `Fit`.
    slopes
        (k, x, z) derivatives of gamma by what else is asked.
    """
    x, z, camera = views.x_c_mm, views.z_c_mm, views.camera
    gamma, climb = np.zeros((len(x), len(z))), np.zeros((len(x), len(z)))
    if views.optics is not None:
        gamma, climb = _gamma(x, z, views.optics), _climb(views) / _noise(views.counts)
    slopes = np.zeros((0, *gamma.shape)) if slopes is None else slopes
    count, frames = 5 + len(slopes), len(views.angles_rad)
    normal, gradient = np.zeros((len(z), count, count)), np.zeros((len(z), frames, count))
    differences = np.empty((frames, *gamma.shape), np.float32)
    by_angle = np.empty((2, frames, *gamma.shape), np.float32)
    weights = np.empty_like(differences)
    distance = 1e12 if views.optics is None else min(views.optics.distance_mm, 1e12)
    add_up(
        coefficients, views.angles_rad, views.time, x, z, gamma, slopes, climb, parameters,
        np.array([camera.pixel_mm, camera.optical_row - views.first_row, distance]),
        normal, gradient, differences, by_angle, weights,
    )  # fmt: skip
    return ViewComparison(normal, gradient, differences, by_angle, weights, gamma)


def _gamma(x_mm: FloatArray, z_mm: FloatArray, optics: Optics) -> FloatArray:
    return camera_to_virtual(x_mm[:, None], z_mm, optics).direction_rad


def _climb(views: Views) -> FloatArray:
    """Return by how many rows (x, z) a ray and its opposite differ in height, RMS over the resin that they cross."""
    assert views.optics is not None
    rays = camera_to_virtual(views.x_c_mm[:, None], views.z_c_mm, views.optics)
    half_chord = np.sqrt(np.maximum(views.optics.inner_radius_mm**2 - rays.virtual_x_mm**2, 0))
    return np.asarray(2 * np.abs(rays.slope) * half_chord / np.sqrt(3) / views.camera.pixel_mm)


def _noise(counts: Float32Array) -> float:
    """Return what noise leaves in the difference of two smoothed views, counts."""
    pixel = 1.4826 * float(np.median(np.abs(np.diff(counts[:, :: ROW_STEP * 2], axis=0)))) / np.sqrt(2)
    return float(max(_NOISE_LEFT * pixel, 1e-6 * float(counts.max()), 1e-30))


def fit(views: Views, start: FloatArray, *, smoothing: float = LAST_LOOK) -> Fit:
    """Find axis, tilt, run-out and drift by Gauss-Newton steps on the differences of opposite views.

    Parameters
    ----------
    views
        The frames.
    start
        (5,) parameters to start from, the axis within some columns.
    smoothing
        Columns, see `LAST_LOOK`.
    """
    parameters = start.astype(np.float64)
    free = np.ones(5, bool) if views.optics is not None else np.array([True, True, False, False, True])
    coefficients = smoothed_splines(views, smoothing)
    for _ in range(_PASSES):
        compared = compare(_about(views, parameters), coefficients, parameters)
        step, covariance = gauss_newton(compared, PRIOR, free)
        parameters = parameters + np.clip(step, -PRIOR / 4, PRIOR / 4)
        if (np.abs(step[free]) <= _SETTLED * np.sqrt(np.diag(covariance)[free])).all():
            break
    return Fit(parameters, covariance, compare(_about(views, parameters), coefficients, parameters))


def _about(views: Views, parameters: FloatArray) -> Views:
    """Return the views with the axis where the parameters have it, so that as many rays as can be are compared."""
    return replace(views, camera=views.camera.model_copy(update={"axis_column": float(parameters[AXIS])}))


def by_sector(by_frame: FloatArray, axis: int = 0) -> FloatArray:
    """Add up over the frames of each sector: neighbouring frames are smoothed together and so not independent."""
    count = by_frame.shape[axis]
    starts = np.linspace(0, count, min(SECTORS, count), endpoint=False).astype(int)
    return np.asarray(np.add.reduceat(by_frame, starts, axis=axis))


def gauss_newton(compared: ViewComparison, prior: FloatArray, free: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return the step to the least differences, and the covariance of the parameters.

    What is wrong with a row, its noise, is seen in how the rows' gradients differ; what is wrong with a frame, its
    angle or light, in how those of frames do.  So the covariance is that of gradients clustered by rows and by sectors
    of the turn (Cameron, Gelbach and Miller 2011), and needs no model of the noise.
    """
    span = prior[free]
    normal = compared.normal.sum(axis=0)[np.ix_(free, free)] * span[:, None] * span
    gradient = compared.gradient[:, :, free] * span
    # Weak enough to leave alone whatever the frames determine.
    held = normal + 1e-9 * np.trace(normal) * np.eye(len(span))
    inverse = np.linalg.inv(held)
    starts = np.arange(0, len(gradient), ROWS_A_BLOCK // ROW_STEP)
    blocks = np.add.reduceat(by_sector(gradient, axis=1), starts, axis=0)
    frames, cells = blocks.sum(axis=0), blocks.reshape(-1, len(span))
    # Blocks are few, and some decide nearly by themselves: each as it is where the others are fitted (a jackknife); but
    # for a tenth, so that one that decides alone does not end at infinity.
    block_normal = np.add.reduceat(compared.normal[:, free][:, :, free], starts, axis=0) * span[:, None] * span
    others = np.eye(len(span)) - 0.9 * block_normal @ inverse
    rows = np.linalg.solve(others, blocks.sum(axis=1)[..., None])[..., 0]
    by_rows, by_frames, by_cells = (part.T @ part for part in (rows, frames, cells))
    excess, directions = np.linalg.eigh(by_frames - by_cells)
    scatter = by_rows + directions * np.maximum(excess, 0) @ directions.T
    step, covariance = np.zeros(len(prior)), np.zeros((len(prior), len(prior)))
    step[free] = -(inverse @ gradient.sum(axis=(0, 1))) * span
    covariance[np.ix_(free, free)] = inverse @ scatter @ inverse * span[:, None] * span
    return step, covariance


__all__ = ["AXIS", "DRIFT", "OUT_X", "OUT_Y", "PRIOR", "TILT", "Fit", "ViewComparison", "Views", "compare", "fit"]
