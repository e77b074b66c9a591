# SPDX-License-Identifier: Apache-2.0
"""State estimation for a bench with any effects: initial states of predictions, with covariances.

An extended Kalman filter on the bench's model follows a run. Its estimate where a window begins is the window's first
guess, and its covariance gives the directions in which the start may be wrong: the columns of `root`, each one standard
deviation. Past currents are the recorded ones.
"""

from __future__ import annotations

from math import comb

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.model.bench_model import TEXTBOOK, BenchModel
from hydro_sim.model.sensitivities import Sensitivities, Track

SETTLED = 600
"""Samples at the beginning of a run without predictions: the filter is still settling."""

Indices = npt.NDArray[np.int64]

ORDER = 6
"""Order of the differences by which noise is measured: they reduce motion below 100 Hz to a thirtieth."""

MISSED_PRESSURE, MISSED_VELOCITY, MISSED_HIDDEN = 6e-6, 2.5e-4, 1e-4
"""Model error per sample at a trust of 1, standard deviations: of the supply pressure, of the stroke per
second, and of a hidden state's typical size."""


def noise_of(runs: list[Run]) -> FloatArray:
    """Standard deviation of the five readings' noise, shape (5,), from their differences between samples."""
    squares = [np.mean(np.diff(run.readings, ORDER, axis=0) ** 2, axis=0) for run in runs]
    spread = np.sqrt(np.mean(squares, axis=0) / comb(2 * ORDER, ORDER))
    moved = np.std(np.concatenate([run.readings for run in runs]), axis=0)
    return np.asarray(np.maximum(spread, 1e-6 * moved + 1e-12))


class StateEstimator:
    """The extended Kalman filter with a model's parameters.

    Parameters
    ----------
    exact
        The model.
    theta
        Its parameters.
    noise
        Standard deviation of the readings, shape (5,).
    trust
        Scale of the model error, in units of `MISSED_*`.
    """

    def __init__(self, exact: Sensitivities, theta: FloatArray, noise: FloatArray, trust: float) -> None:
        self.exact, self.theta, self.noise = exact, theta, noise
        self.k, _ = exact.coefficients(theta)
        self.q = (trust * process_noise(exact.model)[: exact.held]) ** 2

    def states(self, run: Run) -> FloatArray:
        """Return the states at every sample of a run, shape (n, states)."""
        track = self._begin(run)
        first = track.y.copy()
        rest = self.exact.follow(self.k, track, run.u[:-1], run.readings[1:], self.q, self.noise**2)
        return np.concatenate([first[None], rest])

    def starts(self, run: Run, samples: Indices) -> tuple[FloatArray, FloatArray]:
        """Return first guesses of windows that begin at some samples of a run, in rising order.

        States, shape (n, states), and square roots of their covariances, shape (n, held, held).
        """
        track, at, readings, r = self._begin(run), 0, run.readings, self.noise**2
        held = self.exact.held
        states, roots = np.empty((len(samples), len(track.y))), np.empty((len(samples), held, held))
        scales = np.array([state.scale for state in self.exact.model.states])[:held]
        for i, sample in enumerate(samples):
            self.exact.follow(self.k, track, run.u[at:sample], readings[at + 1 : sample + 1], self.q, r)
            at = int(sample)
            states[i], roots[i] = track.y, scales[:, None] * _root(track.covariance / np.outer(scales, scales))
        return states, roots

    def _begin(self, run: Run) -> Track:
        model = self.exact.model
        y: FloatArray = np.zeros(len(model.states))
        y[:TEXTBOOK] = run.x[0, [4, 5, 6, 7, 2, 3]]
        y = self.exact.begin(self.theta, y)
        spread = np.array([state.scale for state in model.states])[: self.exact.held]
        spread[:3] = 3.0 * self.noise[2:]
        return Track(y, np.diag(spread**2))


def process_noise(model: BenchModel) -> FloatArray:
    """Process noise: standard deviation per sample of each state at a trust of 1, shape (states,)."""
    result = MISSED_HIDDEN * np.array([state.scale for state in model.states])
    result[:TEXTBOOK] = 0.0
    result[:2] = MISSED_PRESSURE * model.bench.supply_pressure
    result[3] = MISSED_VELOCITY * model.bench.stroke
    return result


def _root(covariance: FloatArray) -> FloatArray:
    """A matrix whose product with its own transpose it is."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
