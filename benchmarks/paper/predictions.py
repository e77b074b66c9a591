# SPDX-License-Identifier: Apache-2.0
"""Errors of multi-step predictions by any model, and the bench models with the box's rates of their readings.

Every prediction starts from the model's own estimate of the state, by past samples alone, and runs under the recorded
current; it is compared with the noise-free log.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import READING_COLUMNS, Run
from hydro_sim.identification.bench_learning import SUBSTEPS, best_prediction_rmse
from hydro_sim.identification.bench_states import SETTLING_SAMPLES, Sensitivities, estimate_noise
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.sensors import Sensors


class Predictor(Protocol):
    """Interface of a prediction model under validation: state estimation, and multi-step prediction by currents."""

    def estimate(self, run: Run) -> FloatArray:
        """Return the states at the samples of a run."""

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """Return x, shape (n, H, 8), from initial states, shape (n, ...), under currents [A], shape (n, H)."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one predictor on one recording, SI units."""

    by_time: FloatArray
    """RMS of the errors over all windows, by sample of the horizon, shape (H, 8)."""
    windows: int

    @property
    def rmse(self) -> FloatArray:
        """RMSE over all windows and samples of the horizon, shape (8,)."""
        return np.asarray(np.sqrt(np.mean(self.by_time**2, axis=0)))


@dataclass(frozen=True, kw_only=True)
class ScoredRun:
    """Recorded run with the reference that predictions are compared with."""

    run: Run
    truth: FloatArray
    """The noise-free log at the run's samples, shape (n, 8)."""


def prediction_errors(
    predictor: Predictor, states: list[FloatArray], scored: list[ScoredRun], *, horizon: int, stride: int
) -> Errors:
    """Return the errors of predictions from `states` at the starts of windows, over all windows of all runs."""
    squares, windows = np.zeros((horizon, 8)), 0
    for begins, item in zip(states, scored, strict=True):
        starts = np.arange(SETTLING_SAMPLES, len(item.run) - horizon - 1, stride)
        windows += len(starts)
        for part in np.array_split(starts, max(len(starts) * horizon // 500_000, 1)):
            rows = part[:, None] + np.arange(horizon)
            squares += ((predictor.predict(begins[part], item.run.u[rows]) - item.truth[rows + 1]) ** 2).sum(axis=0)
    return Errors(by_time=np.sqrt(squares / windows), windows=windows)


RATE_COLUMNS, DIFFERENTIATED_COLUMNS = (1, 3, 7), (0, 2, 6)
"""Columns of x that the box computes, and those of the readings that it differentiates for them."""


class ModelPrediction:
    """Predictions of a bench model with coefficients `k`, with the box's rates of its readings.

    `states`: estimator of the model's states at the samples of a run.
    """

    def __init__(self, model: BenchModel, k: FloatArray, states: Callable[[Run], FloatArray]) -> None:
        self.model, self.k, self.states = model, k, states
        box = Sensors().constants()[0]
        self.memories = np.array([box["force_memory"], box["force_memory"], box["velocity_memory"]])
        """Coefficients of the rates' filters."""

    def estimate(self, run: Run) -> FloatArray:
        """Return initial values of predictions: model states, box rates, their readings; shape (n, states + 6)."""
        return np.concatenate([self.states(run), run.x[:, RATE_COLUMNS], run.x[:, DIFFERENTIATED_COLUMNS]], axis=1)

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """Return x, shape (n, H, 8), under currents [A], shape (n, H)."""
        x = np.empty((*currents.shape, 8))
        states, rates, last = np.split(starts, (len(self.model.states), -3), axis=1)
        for i, y in enumerate(states):
            x[i][:, READING_COLUMNS] = self.model.rollout(self.k, y.copy(), np.ascontiguousarray(currents[i]))
        for h in range(currents.shape[1]):
            now = x[:, h, DIFFERENTIATED_COLUMNS]
            rates = self.memories * rates + (1.0 - self.memories) * (now - last) / SAMPLE_PERIOD
            x[:, h, RATE_COLUMNS], last = rates, now
        return x


class AnalyticModel(ModelPrediction):
    """Analytic model without effects, except corrections of parameters; predictions start at the measurements."""

    def __init__(self, bench: Bench) -> None:
        model = BenchModel(bench.without_effects(), substeps=SUBSTEPS)
        measured = [PLANT_FIELDS.index(state.name) for state in model.states]
        super().__init__(model, model.begin(model.values)[0], lambda run: run.x[:, measured])


class BenchPrediction(ModelPrediction):
    """Predictions of a bench file from the Kalman filter's states.

    `runs`: for evaluation; the noise is estimated from them, and the filter's model error with the lowest RMSE chosen.
    """

    def __init__(self, bench: Bench, runs: list[Run]) -> None:
        model, noise = BenchModel(bench, substeps=SUBSTEPS), estimate_noise(runs)
        _, estimator = best_prediction_rmse(Sensitivities(model), model.values, noise, runs)
        super().__init__(model, estimator.k, estimator.states)
