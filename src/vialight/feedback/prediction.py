"""When to stop: the resin that explains best when places were seen to cure, and what stop that resin wants.

With ``u = ln(sensitivity)`` and doubts ``z``, each of unit prior variance, place i is seen to cure at

    ln t_i = m_i(u) + sum_k z_k c_ik + noise                     m, c from `StopModel`
    ln t_stop = s(u) + sum_k z_k g_k

The most probable u and z are found by Newton's method.  Places that have not been seen to cure yet count as censored
(Tobin 1958): all that is known of them is that their time is later than now; leaving them out would favour those that
noise has let cross early.  Residuals beyond 2.5 standard deviations pull no harder (Huber 1964), and the places of a
block count as one between them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from vialight.arrays import BoolArray, FloatArray
from vialight.feedback.history import StopHistory
from vialight.feedback.model import StopModel

SENSITIVITY_SPREAD = 0.5
"""Standard deviation of the prior of ln(sensitivity): lots are expected within a factor of about 1.6 of nominal."""
LEAST_NOISE = 0.01
"""Standard deviation of the logarithm of a place's time, at least."""
MODEL_ERROR = 0.007
"""Standard deviation of ln(t_stop) when all crossings are explained: that of the model's own best stop."""
LEAST_BLOCKS = 12
"""Blocks that must have been seen to cure before a stop is acted on."""
LEAST_SHARE = 0.05
"""Share of the places that must have been."""

_PULL = 2.5
_STEPS = 8


@dataclass(frozen=True)
class StopPrediction:
    """When the light should go off, as far as can be told now.

    Parameters
    ----------
    stop_s
        Lit time at which to turn the light off: the phase of a turn near `best_s` at which the dose is even enough.
    best_s
        Lit time at which the final shape, dark cure included, would be best if every moment brought an even dose.
    sigma_s
        Standard deviation of `best_s`; infinite before anything has cured.
    sensitivity
        Of the resin, relative to nominal.
    why
        The reasons, in a sentence, for the log.
    is_ready
        Whether enough has been seen to act on it.
    """

    stop_s: float
    best_s: float
    sigma_s: float
    sensitivity: float
    why: str
    is_ready: bool


def predict(model: StopModel, history: StopHistory) -> StopPrediction:
    """Predict when the light should go off.

    Parameters
    ----------
    model
        Made before the print.
    history
        What has been seen, see `vialight.feedback.history.observe`.

    Returns
    -------
    StopPrediction
        In lit time.

    Examples
    --------
    A resin that cures everything 20 % sooner than nominal wants its light off 20 % sooner:

    >>> points = np.random.default_rng(0).uniform(-5, 5, (500, 3))
    >>> nominal_s = 250 + 5 * points[:, 2]
    >>> model = StopModel(
    ...     points, 0.2, np.array([0.5, 1.0, 2.0]), np.outer([2.0, 1.0, 0.5], nominal_s),
    ...     np.array([540.0, 270.0, 135.0]), (), 18.0, np.zeros(12),
    ... )
    >>> seen_s = nominal_s * 0.8
    >>> history = StopHistory(205.0, np.zeros(500), np.where(seen_s < 205, seen_s, np.nan))
    >>> round(predict(model, history).best_s)
    216
    """
    known: BoolArray = np.asarray(np.isfinite(model.crossing_s).all(axis=0))
    for doubt in model.doubts:
        known = known & np.isfinite(doubt.crossing_change)
    seen = np.isfinite(history.crossing_s)
    if not (seen & known).any():
        best = float(np.exp(np.interp(0.0, np.log(model.sensitivities), np.log(model.stop_s))))
        return StopPrediction(best, best, float("inf"), 1.0, "nothing watched has been seen to cure yet", False)
    fit = _fit(model, history, known)
    best, sigma = float(np.exp(fit.ln_stop)), float(np.exp(fit.ln_stop) * fit.sigma)
    stop = _even_enough(best, model)
    blocks = model.blocks()
    is_wide = len(np.unique(blocks[seen & known])) >= min(LEAST_BLOCKS, len(np.unique(blocks[known])))
    ready = is_wide and bool((seen & known).sum() >= LEAST_SHARE * known.sum())
    sensitivity = float(np.exp(fit.parameters[0]))
    why = (
        f"{int((seen & known).sum())} of {int(known.sum())} places have cured, as in resin {sensitivity:.3f} times as "
        f"sensitive as nominal, to {100 * fit.misfit:.1f} %; best after {best:.1f} +- {sigma:.1f} s of light, and even "
        f"enough at {stop:.1f} s ({stop / model.turn_s:.2f} turns)"
    )
    return StopPrediction(stop, best, sigma, sensitivity, why, ready)


def should_stop(prediction: StopPrediction, now_s: float) -> bool:
    """Return whether the light should be off at a lit time."""
    return prediction.is_ready and now_s >= prediction.stop_s


@dataclass(frozen=True)
class _Fit:
    """Most probable (u, z), ln(t_stop) and its standard deviation, and what of the crossings stays unexplained."""

    parameters: FloatArray
    ln_stop: float
    sigma: float
    misfit: float


def _fit(model: StopModel, history: StopHistory, known: BoolArray) -> _Fit:
    ln_s, ln_stop = np.log(model.sensitivities), np.log(model.stop_s)
    ln_cross = np.log(model.crossing_s[:, known])
    changes = np.array([doubt.crossing_change[known] for doubt in model.doubts]).reshape(-1, ln_cross.shape[1])
    stop_changes = np.array([doubt.stop_change for doubt in model.doubts])
    observed = np.log(history.crossing_s[known])
    seen = np.isfinite(observed)
    ln_now = np.log(history.lit_s)
    _, block, counts = np.unique(model.blocks()[known], return_inverse=True, return_counts=True)
    share = 1 / counts[block]
    precision = np.diag(np.r_[SENSITIVITY_SPREAD**-2, np.ones(len(changes))])
    parameters = np.zeros(1 + len(changes))
    parameters[0] = _first_guess(ln_s, ln_cross[:, seen], observed[seen])
    noise = 0.05
    for _ in range(_STEPS):
        expected, slope = _at(parameters[0], ln_s, ln_cross)
        expected = expected + parameters[1:] @ changes
        error, weight = _errors(observed, seen, expected, ln_now, noise)
        jacobian = np.vstack([slope, changes])
        hessian = precision + (jacobian * (share * weight / noise**2)) @ jacobian.T
        gradient = jacobian @ (share * error / noise**2) - precision @ parameters
        step = np.linalg.solve(hessian, gradient)
        parameters = parameters + step
        crossed = np.abs((observed - expected)[seen])
        noise = max(LEAST_NOISE, 1.4826 * float(np.median(crossed)))
    at_stop, stop_slope = _at(parameters[0], ln_s, ln_stop[:, None])
    direction = np.r_[stop_slope, stop_changes]
    misfit = _misfit(error, block, expected, ln_now, noise)
    variance = direction @ np.linalg.solve(hessian, direction) + misfit**2 + MODEL_ERROR**2
    return _Fit(parameters, float(at_stop[0] + parameters[1:] @ stop_changes), float(np.sqrt(variance)), misfit)


def _first_guess(ln_s: FloatArray, ln_cross: FloatArray, observed: FloatArray) -> float:
    """Return ln(sensitivity) at which half of what has been seen was to be expected as early."""
    middle = np.median(ln_cross - observed, axis=1)  # falls as sensitivity rises
    return float(np.interp(0.0, -middle, ln_s))


def _at(u: float, ln_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interpolate (resin, n) logarithms at u, straight on beyond the ends; return values and slopes."""
    j = int(np.clip(np.searchsorted(ln_s, u) - 1, 0, len(ln_s) - 2))
    slope = (values[j + 1] - values[j]) / (ln_s[j + 1] - ln_s[j])
    return values[j] + slope * (u - ln_s[j]), slope


def _errors(
    observed: FloatArray, seen: BoolArray, expected: FloatArray, ln_now: float, noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return what each place says that its expectation is off by, and how surely, 0 to 1.

    Of a place not seen yet: the mean of what a normal distribution has beyond now, and one minus its variance.
    """
    z = np.clip((ln_now - expected) / noise, -8.0, _PULL)
    hazard = np.exp(-(z**2) / 2 - log_ndtr(-z)) / np.sqrt(2 * np.pi)
    apart = np.clip(np.nan_to_num(observed - expected), -_PULL * noise, _PULL * noise)
    return np.where(seen, apart, noise * hazard), np.where(seen, 1.0, hazard * (hazard - z))


def _misfit(error: FloatArray, block: np.ndarray, expected: FloatArray, ln_now: float, noise: float) -> float:
    """Return the spread of the blocks' mean errors, of places that should have been seen by now."""
    due = ln_now - expected > noise
    counts = np.bincount(block, weights=due)
    sums = np.bincount(block, weights=np.where(due, error, 0.0))
    means = sums[counts > 0] / counts[counts > 0]
    return float(np.std(means)) if len(means) > 1 else noise


def _even_enough(best_s: float, model: StopModel) -> float:
    """Return the time near the best at which being late or early and an uneven dose together cost least."""
    phases = len(model.waiting_s)
    times = best_s + np.linspace(-0.5, 0.5, 361) * model.turn_s
    times = times[times > 0]
    phase = (times / model.turn_s) % 1.0 * phases
    waiting = np.interp(phase, np.arange(phases + 1), np.r_[model.waiting_s, model.waiting_s[0]])
    return float(times[np.argmin((times - best_s) ** 2 + waiting**2)])
