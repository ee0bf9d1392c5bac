"""The forecast of the stop, from live volumes that come one after another."""

from __future__ import annotations

import numpy as np

from vialight.control.history import fresh_history, observe, places, sample
from vialight.control.prediction import predict
from vialight.control.stop_model import StopModel
from vialight.core.arrays import Float32Array, Grid
from vialight.core.messages import StopForecast


class Forecaster:
    """Sees each live volume once, and says when the light should go off.

    Parameters
    ----------
    model
        What is believed before the print.
    grid
        Of the volumes.
    threshold
        I_p, counts per mm.

    Raises
    ------
    InputError
        The model watches a place that lies outside the grid.
    """

    def __init__(self, model: StopModel, grid: Grid, threshold: float) -> None:
        self._model, self._gelled = model, model.gel_share * threshold
        self._places, self._history = places(model, grid), fresh_history(model)

    def add(self, volume: Float32Array, lit_s: float) -> StopForecast | None:
        """Take the newest volume; return the forecast, or None while it is too early for one.

        Parameters
        ----------
        volume
            Density as a sliding window keeps it, counts per mm.
        lit_s
            For how long there has been light by the newest frame in it.
        """
        if not lit_s > 0:
            return None
        had_gelled = np.isfinite(self._history.crossing_s).any()
        self._history = observe(self._history, sample(volume, self._places), lit_s, self._gelled)
        if not had_gelled and not np.isfinite(self._history.crossing_s).any():
            return None
        told = predict(self._model, self._history)
        return StopForecast(told.stop_s, told.sigma_s, told.why) if told.is_ready else None
