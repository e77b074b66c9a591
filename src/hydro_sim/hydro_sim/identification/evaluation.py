# SPDX-License-Identifier: Apache-2.0
"""Evaluation of a model: the paper's Table rmse_model, errors over the horizon, by region, and a free run.

Every prediction starts from the model's own estimate of the state, which looks only back, and runs under the recorded
current. Errors are normalized per state either by the standard deviation of the recording or by its range (largest
minus smallest, of the noise-free log where there is one): the paper does not say which it used, so both are given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.files.recordings import READING_COLUMNS, Run
from hydro_sim.identification.bench_learning import SUBSTEPS, best_prediction_rmse
from hydro_sim.identification.bench_states import SETTLED, Indices, noise_of
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.compiled_equations import equations
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.quality import Quality
from hydro_sim.model.sensitivities import Sensitivities
from hydro_sim.model.sensors import Sensors


class Predictor(Protocol):
    """A model under evaluation."""

    def estimate(self, run: Run) -> FloatArray:
        """States at the samples of a run."""

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8)."""


@dataclass(frozen=True, kw_only=True)
class Errors:
    """Errors of one predictor on one recording, SI units."""

    rmse: FloatArray
    """Over all windows and samples of the horizon, shape (8,)."""
    by_time: FloatArray
    """Over all windows, shape (H, 8)."""
    by_window: FloatArray
    """Over each window's horizon, shape (n, 8)."""


def window_starts(run: Run, horizon: int, stride: int) -> Indices:
    """Start samples of a run's predictions, after the observer has settled."""
    return np.arange(SETTLED, len(run) - horizon - 1, stride)


def errors(predictor: Predictor, states: FloatArray, run: Run, truth: FloatArray, horizon: int, stride: int) -> Errors:
    """Errors of predictions from `states` at the starts of windows against `truth`, shape (n, 8)."""
    starts = window_starts(run, horizon, stride)
    squares_time, squares_window = np.zeros((horizon, 8)), []
    for part in np.array_split(starts, max(len(starts) * horizon // 500_000, 1)):
        rows = part[:, None] + np.arange(horizon)
        square = (predictor.predict(states[part], run.u[rows]) - truth[rows + 1]) ** 2
        squares_time += square.sum(axis=0)
        squares_window.append(square.mean(axis=1))
    by_time = np.sqrt(squares_time / len(starts))
    return Errors(
        rmse=np.sqrt(np.mean(by_time**2, axis=0)), by_time=by_time, by_window=np.sqrt(np.concatenate(squares_window))
    )


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Scales of the errors, shape (8,) each."""

    std: FloatArray
    span: FloatArray

    @classmethod
    def of(cls, x: FloatArray) -> Scales:
        """Standard deviation and range of the columns of x, shape (n, 8)."""
        return cls(std=x.std(axis=0), span=np.ptp(x, axis=0))


@dataclass(frozen=True, kw_only=True)
class Scored:
    """One recorded run with its reference."""

    run: Run
    truth: FloatArray | None
    """The noise-free log at the run's samples, shape (n, 8), or None."""

    @property
    def reference(self) -> FloatArray:
        """The noise-free log, or the recording itself."""
        return self.run.x if self.truth is None else self.truth


def pooled(parts: list[Errors]) -> Errors:
    """Errors of several runs together, each window counting once."""
    counts = np.array([len(part.by_window) for part in parts], float)
    weights = counts / counts.sum()
    by_time = np.sqrt(sum(w * part.by_time**2 for w, part in zip(weights, parts, strict=True)))
    return Errors(
        rmse=np.sqrt(np.mean(by_time**2, axis=0)), by_time=by_time,
        by_window=np.concatenate([part.by_window for part in parts]),
    )  # fmt: skip


def prediction_errors(
    predictor: Predictor, states: list[FloatArray], scored: list[Scored], *, recorded: bool, horizon: int, stride: int
) -> Errors:
    """Pooled errors on several runs, against the recordings themselves or against the noise-free logs."""
    truths = [item.run.x if recorded else item.reference for item in scored]
    parts = [
        errors(predictor, start, item.run, truth, horizon, stride)
        for start, item, truth in zip(states, scored, truths, strict=True)
    ]
    return pooled(parts)


def noise_floor(scored: list[Scored]) -> FloatArray | None:
    """Noise floor, shape (8,): RMS of recording minus noise-free log; None without a log."""
    differences = [item.run.x - item.truth for item in scored if item.truth is not None]
    return np.sqrt(np.mean(np.concatenate(differences) ** 2, axis=0)) if len(differences) == len(scored) else None


def omitted_terms(bench: Bench) -> str:
    """A sentence that names the bench file's effects and closures, which this model omits.

    Elements with memory (spool, bristles, a dead time) cannot start from a measurement there. Closed-loop simulations
    start at rest and leave nothing out: `hydro_sim.model.plant.AnalyticPlant`.
    """
    names = ", ".join(map(label, bench.terms))
    return f"of the bench file's effects the analytic model's predictions leave out {names}" if names else ""


class AnalyticModel:
    """The equations with the bench file's values.

    Starts of predictions are the textbook's states and the box's rates, shape (n, 9).
    """

    def __init__(self, bench: Bench) -> None:
        self.constants = bench.constants()
        record = Sensors().constants()[0]
        self.memories = np.array([record["force_memory"], record["velocity_memory"]])

    def estimate(self, run: Run) -> FloatArray:
        """The measurements themselves."""
        return np.ascontiguousarray(run.x[:, [4, 5, 6, 7, 2, 3, 1, 3, 7]])

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), under currents [A], shape (n, H)."""
        return np.asarray(_rollout(self.constants, self.memories, starts, np.ascontiguousarray(currents)))


@njit
def _read(bench, y, reading):
    reading[0] = equations.hydraulic_force(bench, y[0], y[1])
    reading[1], reading[2], reading[3], reading[4] = y[4], y[0], y[1], y[2]


@njit
def _differentiate(memories, before, after, rates):
    """The box's three rates a sample later (hydro_sim.model.sensors.condition, without noise)."""
    force, velocity = memories[0], memories[1]
    rates[0] = force * rates[0] + (1.0 - force) * (after[0] - before[0]) / SAMPLE_PERIOD
    rates[1] = force * rates[1] + (1.0 - force) * (after[1] - before[1]) / SAMPLE_PERIOD
    rates[2] = velocity * rates[2] + (1.0 - velocity) * (after[4] - before[4]) / SAMPLE_PERIOD


@njit
def _rollout(constants, memories, starts, currents):
    n, horizon = currents.shape
    measured = np.empty((n, horizon, 8))
    for k in range(n):
        y, before, after = np.empty(hydraulics.STATES), np.empty(5), np.empty(5)
        copy_vector(y, starts[k, : hydraulics.STATES])
        rates = starts[k, hydraulics.STATES :].copy()
        _read(constants[0], y, before)
        for h in range(horizon):
            hydraulics.advance(constants[0], y, currents[k, h], SAMPLE_PERIOD, hydraulics.SUBSTEPS)
            _read(constants[0], y, after)
            _differentiate(memories, before, after, rates)
            measured[k, h, 0], measured[k, h, 2] = after[0], after[1]
            measured[k, h, 4], measured[k, h, 5], measured[k, h, 6] = after[2], after[3], after[4]
            measured[k, h, 1], measured[k, h, 3], measured[k, h, 7] = rates
            copy_vector(before, after)
    return measured


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
