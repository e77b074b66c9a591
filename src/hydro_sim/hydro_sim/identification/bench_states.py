# SPDX-License-Identifier: Apache-2.0
"""Exact sensitivities of a bench model's predictions, and state estimation: initial states with covariances.

::

    exact = Sensitivities(BenchModel(bench))
    k, dk = exact.coefficients(model.values)                 dk: d k/d theta
    z, dz, y = exact.window(k, y, currents, dy, dk[:, free]) readings of a prediction, and their derivatives
    exact.filter_states(k, start, currents, readings, q, r)  states at the samples: an extended Kalman filter

Derivatives are forward: any number of directions is propagated with the states, each by the partial derivatives of one
integration step, which come from the model's symbols. With p directions a sample costs its partial derivatives once,
and a multiplication for each of them and each direction.

Past currents (of a dead time) are known exactly: directions and covariances leave them out. `estimated` is the number
of the other states.

`StateEstimator` runs the filter on a recorded run. Its estimate at the begin of a window is the initial state's first
guess, and its covariance gives the directions of the estimate's error: columns of `root`, each one standard deviation.
"""

from __future__ import annotations

import ctypes
from math import comb

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.model.bench_model import TEXTBOOK_STATE_COUNT, BenchModel, library, to_c
from hydro_sim.model.equations import READINGS

SETTLING_SAMPLES = 600
"""Samples at the beginning of a run without predictions: the filter is still settling."""

Indices = npt.NDArray[np.int64]

DIFFERENCE_ORDER = 6
"""Order of the differences by which noise is estimated: they reduce motion below 100 Hz to a thirtieth."""
MODEL_ERROR_PRESSURE, MODEL_ERROR_VELOCITY, MODEL_ERROR_HIDDEN = 6e-6, 2.5e-4, 1e-4
"""Model error per sample at a scale of 1, standard deviations: of the supply pressure, of the stroke per
second, and of a hidden state's typical size."""


class Sensitivities:
    """Exact sensitivities of a bench model; compiles a new set of effects in 2 to 10 s."""

    def __init__(self, model: BenchModel) -> None:
        self.model = model
        self.estimated = len(model.states) - model.structure.past_currents
        self._code = library(model.structure, "sensitivities")

    def coefficients(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients k, shape (m,), and d k/d theta, shape (m, parameters)."""
        k = np.empty(self.model.coefficients)
        dk = np.empty((len(k), len(self.model.parameters)))
        self._code.bench_once_partials(to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(dk))
        return k, dk

    def rest_state(self, theta: FloatArray, textbook: FloatArray) -> FloatArray:
        """Return the states, shape (states,), of a bench at rest with the textbook states, shape (6,)."""
        y, k, z = np.zeros(len(self.model.states)), np.empty(self.model.coefficients), np.empty(len(READINGS))
        y[:TEXTBOOK_STATE_COUNT] = textbook
        self._code.bench_begin(to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(y), to_c(z))
        return y

    def window(
        self, k: FloatArray, y: FloatArray, currents: FloatArray, dy: FloatArray, dk: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the readings of a prediction, shape (n, 5), their derivatives, shape (n, 5, p), and the final states.

        `k`, `y`, `currents`: coefficients, initial states (not changed), and currents [A], shape (n,). `dy`,
        `dk`: directions: of the estimated initial states, shape (estimated, a), and of the coefficients, shape (m, b).
        p = a + b, in this order.
        """
        first, y = dy.shape[1], y.copy()
        directions = np.zeros((self.estimated + len(k), first + dk.shape[1]))
        directions[: self.estimated, :first], directions[self.estimated :, first:] = dy, dk
        n, p = len(currents), directions.shape[1]
        z, dz, workspace = np.empty((n, len(READINGS))), np.empty((n, len(READINGS), p)), np.empty((self.estimated, p))
        self._code.bench_sensitivities(
            to_c(k, (self.model.coefficients,)), to_c(y, (len(self.model.states),)), ctypes.c_long(n),
            to_c(currents, (n,)), ctypes.c_long(p), to_c(directions), to_c(z), to_c(dz), to_c(workspace),
        )  # fmt: skip
        return z, dz, y

    def filter_states(
        self, k: FloatArray, y: FloatArray, covariance: FloatArray, currents: FloatArray, readings: FloatArray,
        q: FloatArray, r: FloatArray,
    ) -> FloatArray:  # fmt: skip
        """Return filtered states, shape (n, states).

        `y`, `covariance`: states, and covariance of their error, shape (estimated, estimated); updated in place.
        `currents`, `readings`: currents [A], shape (n,), and the readings after each, shape (n, 5). `q`: process noise,
        the variance added to each estimated state per sample, shape (estimated,). `r`: variance of the readings' noise,
        shape (5,).
        """
        n, estimated = len(currents), self.estimated
        states, workspace = np.empty((n, len(self.model.states))), np.empty((2 * estimated + len(k), estimated))
        self._code.bench_follow(
            to_c(k, (self.model.coefficients,)), to_c(y, (len(self.model.states),)),
            to_c(covariance, (estimated, estimated)), ctypes.c_long(n), to_c(currents, (n,)),
            to_c(readings, (n, len(READINGS))), to_c(q, (estimated,)), to_c(r, (len(READINGS),)), to_c(states),
            to_c(workspace),
        )  # fmt: skip
        return states


def estimate_noise(runs: list[Run]) -> FloatArray:
    """Return the standard deviation of the five readings' noise, shape (5,), from differences of samples."""
    squares = [np.mean(np.diff(run.readings, DIFFERENCE_ORDER, axis=0) ** 2, axis=0) for run in runs]
    spread = np.sqrt(np.mean(squares, axis=0) / comb(2 * DIFFERENCE_ORDER, DIFFERENCE_ORDER))
    moved = np.std(np.concatenate([run.readings for run in runs]), axis=0)
    return np.asarray(np.maximum(spread, 1e-6 * moved + 1e-12))


class StateEstimator:
    """Extended Kalman filter of a bench model with parameters `theta`.

    `noise`: standard deviation of the readings, shape (5,). `model_error`: its scale, in `MODEL_ERROR_*`.
    """

    def __init__(self, exact: Sensitivities, theta: FloatArray, noise: FloatArray, model_error: float) -> None:
        self.exact, self.theta, self.noise = exact, theta, noise
        self.k, _ = exact.coefficients(theta)
        self.scales = np.array([one.scale for one in exact.model.states])[: exact.estimated]
        deviation = MODEL_ERROR_HIDDEN * self.scales
        deviation[:TEXTBOOK_STATE_COUNT] = 0.0
        deviation[:2] = MODEL_ERROR_PRESSURE * exact.model.bench.supply_pressure
        deviation[3] = MODEL_ERROR_VELOCITY * exact.model.bench.stroke
        self.q = (model_error * deviation) ** 2

    def states(self, run: Run) -> FloatArray:
        """Return the states at every sample of a run, shape (n, states)."""
        y, covariance = self._begin(run)
        first = y.copy()
        rest = self.exact.filter_states(self.k, y, covariance, run.u[:-1], run.readings[1:], self.q, self.noise**2)
        return np.concatenate([first[None], rest])

    def initial_states(self, run: Run, samples: Indices) -> tuple[FloatArray, FloatArray]:
        """Return initial states of windows that begin at `samples` of a run, in ascending order.

        States, shape (n, states), and square roots of their covariances, shape (n, estimated, estimated).
        """
        (y, covariance), at, readings, scales = self._begin(run), 0, run.readings, self.scales
        states, roots = np.empty((len(samples), len(y))), np.empty((len(samples), len(scales), len(scales)))
        for i, sample in enumerate(samples):
            seen = run.u[at:sample], readings[at + 1 : sample + 1]
            self.exact.filter_states(self.k, y, covariance, *seen, self.q, self.noise**2)
            at, states[i] = int(sample), y
            scaled = covariance / np.outer(scales, scales)
            values, vectors = np.linalg.eigh(0.5 * (scaled + scaled.T))
            roots[i] = scales[:, None] * (vectors * np.sqrt(np.maximum(values, 0.0)))
        return states, roots

    def _begin(self, run: Run) -> tuple[FloatArray, FloatArray]:
        """States and their covariance at the first sample."""
        spread = self.scales.copy()
        spread[:3] = 3.0 * self.noise[2:]
        return self.exact.rest_state(self.theta, run.x[0, [4, 5, 6, 7, 2, 3]]), np.diag(spread**2)
