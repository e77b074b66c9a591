# SPDX-License-Identifier: Apache-2.0
"""A bench file as a predictor: states by its Kalman filter, predictions by its compiled model."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import READING_COLUMNS, Run
from hydro_sim.identification.bench_learning import SUBSTEPS, best_prediction_rmse
from hydro_sim.identification.bench_states import noise_of
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.quality import Quality
from hydro_sim.model.sensitivities import Sensitivities
from hydro_sim.model.sensors import Sensors

RATES = (1, 3, 7)
"""Columns of x that the box computes from the readings 0, 1 and 4, and the coefficient of each."""
DIFFERENTIATED = (0, 1, 4)
MEMORIES = ("force_memory", "force_memory", "velocity_memory")


class BenchPrediction:
    """A bench file on some recordings.

    Parameters
    ----------
    bench
        The bench file.
    runs
        Runs for its evaluation: their noise is measured, and the filter's trust with the lowest error is taken.
    """

    def __init__(self, bench: Bench, runs: list[Run]) -> None:
        self.model = BenchModel(bench, substeps=SUBSTEPS)
        noise = noise_of(runs)
        left, self.follower = best_prediction_rmse(Sensitivities(self.model), self.model.values, noise, runs)
        self.quality = Quality.of((left / noise).tolist())
        record = Sensors().constants()[0]
        self.memories = np.array([record[name] for name in MEMORIES])

    def estimate(self, run: Run) -> FloatArray:
        """Start of predictions: the model's states, the box's rates, its readings; shape (n, states + 8)."""
        return np.concatenate([self.follower.states(run), run.x[:, RATES], run.x[:, READING_COLUMNS]], axis=1)

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), under currents [A], shape (n, H)."""
        n, states = len(starts), len(self.model.states)
        x = np.empty((*currents.shape, 8))
        for i in range(n):
            y = starts[i, :states].copy()
            x[i][:, READING_COLUMNS] = self.model.rollout(self.follower.k, y, np.ascontiguousarray(currents[i]))
        rates, last = starts[:, states : states + 3].copy(), starts[:, states + 3 :][:, DIFFERENTIATED]
        columns = [READING_COLUMNS[reading] for reading in DIFFERENTIATED]
        for h in range(currents.shape[1]):
            now = x[:, h, columns]
            rates = self.memories * rates + (1.0 - self.memories) * (now - last) / SAMPLE_PERIOD
            x[:, h, RATES], last = rates, now
        return x
