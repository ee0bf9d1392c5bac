"""When to stop: the sensitivity that explains best when places were seen to cure, and what stop that resin wants.

With ``u = ln(sensitivity)`` and m, s from `StopModel`, place i is seen to cure at ``ln t_i = m_i(u) + noise``, and the
light should go off at ``ln t_stop = s(u)``.  The most probable u is found by Newton's method.  Places that have not
been seen to cure yet count as censored (Tobin 1958): all that is known of them is that their time is later than now;
leaving them out would favour those that noise has let cross early.  Residuals beyond 2.5 standard deviations pull no
harder (Huber 1964), and the places of a block count as one between them.

What else may be wrong with the model, its doubts, is not fitted, since what a live volume leaves unexplained is mostly
not the resin's doing; but how far each would have led astray is worked out and counts as uncertainty (a "consider
analysis", Schmidt 1966).  A doubt that moves the crossings and the stop alike moves the prediction with them, and
costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from vialight.control.history import StopHistory
from vialight.control.stop_model import StopModel
from vialight.core.arrays import BoolArray, FloatArray, IntArray

SENSITIVITY_SPREAD = 0.5
"""Standard deviation of the prior of ln(sensitivity): lots are expected within a factor of about 1.6 of nominal."""
FIRST_NOISE = 0.02
"""Standard deviation of the logarithm of a place's time, to begin with."""
LEAST_NOISE = 0.01
"""The same, at least."""
MODEL_ERROR = 0.01
"""Standard deviation of ln(t_stop) when all crossings are explained: how far a rehearsal's own best stop is off, mostly
for its coarse voxels."""
TOO_EARLY = 4.0
"""Places seen to cure in less than this share of the nominal time are dust or bubbles, not resin, and not watched."""
LEAST_BLOCKS = 12
"""Blocks that must have been seen to cure before a stop is acted on."""
FIRST_SHARE, SURE_SHARE = 0.015, 0.3
"""Shares of the places that must have been: when they agree with the model to within `FIRST_NOISE`, and at any rate."""

_PULL = 2.5
_STEPS_TO_U, _STEPS = 3, 10


@dataclass(frozen=True)
class StopPrediction:
    """When the light should go off, as far as can be told now.

    Parameters
    ----------
    stop_s
        Lit time at which to turn the light off: near `best_s`, where in the turn the dose is even enough.
    best_s
        Lit time at which the final shape, dark cure included, would be best if every moment brought an even dose.
    sigma_s
        Standard deviation of `best_s`; infinite before anything has cured.
    sensitivity
        Of the resin, relative to nominal: that of a resin, otherwise as believed, which would have cured as was seen.
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
        What has been seen, see `vialight.control.history.observe`.

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
    ln_nominal, _ = _at(0.0, np.log(model.sensitivities), np.log(model.crossing_s))
    with np.errstate(invalid="ignore"):
        is_dust = history.crossing_s < np.exp(ln_nominal) / TOO_EARLY
    used = model.is_known & ~is_dust
    seen = used & np.isfinite(history.crossing_s)
    if not seen.any():
        best, _ = _at(0.0, np.log(model.sensitivities), np.log(model.stop_s[:, None]))
        start = float(np.exp(best[0]))
        return StopPrediction(start, start, float("inf"), 1.0, "nothing watched has been seen to cure yet", False)
    fit = _fit(model, history, used)
    best_s, sigma_s, sensitivity = float(np.exp(fit.ln_stop)), fit.sigma * float(np.exp(fit.ln_stop)), np.exp(fit.u)
    stop_s = _even_enough(best_s, model)
    blocks_seen, blocks_used = (len(np.unique(model.block[which])) for which in (seen, used))
    least = FIRST_SHARE if fit.noise <= FIRST_NOISE else SURE_SHARE
    is_ready = blocks_seen >= min(LEAST_BLOCKS, blocks_used) and seen.sum() >= least * used.sum()
    why = (
        f"{seen.sum()} of {used.sum()} places have cured, as in resin {sensitivity:.3f} times as sensitive as nominal, "
        f"each to {100 * fit.noise:.1f} %; shape best after {best_s:.1f} +- {sigma_s:.1f} s of light, dose even enough "
        f"at {stop_s:.1f} s ({stop_s / model.turn_s:.2f} turns)"
    )
    return StopPrediction(stop_s, best_s, sigma_s, float(sensitivity), why, bool(is_ready))


def should_stop(prediction: StopPrediction, now_s: float) -> bool:
    """Return whether the light should be off at a lit time."""
    return prediction.is_ready and now_s >= prediction.stop_s


def crossings_at(model: StopModel, sensitivity: float) -> FloatArray:
    """Return (place,) the lit time at which each place is seen to cure in resin of a sensitivity; NaN where never."""
    ln_cross, _ = _at(float(np.log(sensitivity)), np.log(model.sensitivities), np.log(model.crossing_s))
    return np.asarray(np.exp(ln_cross))


@dataclass(frozen=True)
class _Fit:
    """Most probable u, the noise of a place, ln(t_stop) and its standard deviation."""

    u: float
    noise: float
    ln_stop: float
    sigma: float


def _fit(model: StopModel, history: StopHistory, used: BoolArray) -> _Fit:
    ln_s, ln_cross = np.log(model.sensitivities), np.log(model.crossing_s[:, used])
    observed = np.log(history.crossing_s[used])
    ln_now = float(np.log(history.lit_s))
    block = model.block[used]
    share = 1 / np.bincount(block)[block]
    u, noise = _first_guess(ln_s, ln_cross, observed), FIRST_NOISE
    for step in range(_STEPS):
        expected, slope = _at(u, ln_s, ln_cross)
        error, weight, square = _errors(observed, expected, ln_now, noise)
        pull = slope * share / noise**2
        precision = SENSITIVITY_SPREAD**-2 + float(pull @ (weight * slope))
        u += float(np.clip((float(pull @ error) - u / SENSITIVITY_SPREAD**2) / precision, -0.2, 0.2))
        if step >= _STEPS_TO_U:  # a first guess that is far off is not noise
            noise = max(LEAST_NOISE, float(np.sqrt(np.average(square, weights=share))))
    ln_stop, stop_slope = (float(value[0]) for value in _at(u, ln_s, np.log(model.stop_s[:, None])))
    variance = stop_slope**2 / precision + _misfit(error, block, expected, ln_now, noise) ** 2 + MODEL_ERROR**2
    for doubt in model.doubts:
        led_astray = float(pull @ (weight * doubt.crossing_change[used])) / precision
        variance += (stop_slope * led_astray - doubt.stop_change) ** 2
    return _Fit(u, noise, ln_stop, float(np.sqrt(variance)))


def _first_guess(ln_s: FloatArray, ln_cross: FloatArray, observed: FloatArray) -> float:
    """Return u at which half of what has been seen was to be expected as early."""
    late = np.nanmedian(observed - ln_cross, axis=1)  # rises with sensitivity
    guess, _ = _at(0.0, late, ln_s[:, None])
    return float(guess[0])


def _at(u: float, ln_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Interpolate (resin, n) logarithms at u, straight on beyond the ends; return values and slopes."""
    j = int(np.clip(np.searchsorted(ln_s, u) - 1, 0, len(ln_s) - 2))
    slope = (values[j + 1] - values[j]) / (ln_s[j + 1] - ln_s[j])
    return values[j] + slope * (u - ln_s[j]), slope


def _errors(
    observed: FloatArray, expected: FloatArray, ln_now: float, noise: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return what each place says that its expectation is off by, how surely, 0 to 1, and the square to expect.

    Of a place not seen yet: the mean of what a normal distribution has beyond now, one minus its variance, and its mean
    square.
    """
    seen = np.isfinite(observed)
    z = np.clip((ln_now - expected) / noise, -8.0, _PULL)
    hazard = np.exp(-(z**2) / 2 - log_ndtr(-z)) / np.sqrt(2 * np.pi)
    apart = np.clip(np.nan_to_num(observed - expected), -_PULL * noise, _PULL * noise)
    error = np.where(seen, apart, noise * hazard)
    weight = np.where(seen, 1.0, hazard * (hazard - z))
    return error, weight, np.where(seen, apart**2, noise**2 * (1 + z * hazard))


def _misfit(error: FloatArray, block: IntArray, expected: FloatArray, ln_now: float, noise: float) -> float:
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
