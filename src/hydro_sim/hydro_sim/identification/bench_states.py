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

Past currents (of a dead time) are known exactly: directions and covariances leave them out. `held` is the number of the
other states.

`StateEstimator` follows a run by the filter. Its estimate where a window begins is the window's first guess, and its
covariance gives the directions in which the start may be wrong: the columns of `root`, each one standard deviation.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass
from math import comb

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_sim.files.recordings import Run
from hydro_sim.model.bench_model import READINGS, TEXTBOOK, BenchModel, library, to_c

SETTLING_SAMPLES = 600
"""Samples at the beginning of a run without predictions: the filter is still settling."""

Indices = npt.NDArray[np.int64]

SERIES_ORDER = 6
"""Order of the differences by which noise is measured: they reduce motion below 100 Hz to a thirtieth."""

MODEL_ERROR_PRESSURE, MODEL_ERROR_VELOCITY, MODEL_ERROR_HIDDEN = 6e-6, 2.5e-4, 1e-4
"""Model error per sample at a trust of 1, standard deviations: of the supply pressure, of the stroke per
second, and of a hidden state's typical size."""


@dataclass
class FilterState:
    """State of a filter, updated in place."""

    y: FloatArray
    """States, shape (states,)."""
    covariance: FloatArray
    """Covariance of their error, shape (held, held)."""


class Sensitivities:
    """Exact sensitivities of a bench model; compiles a new set of effects in 2 to 10 s."""

    def __init__(self, model: BenchModel) -> None:
        self.model = model
        self.held = len(model.states) - model.structure.past
        self._code = library(model.structure, "sensitivities")

    def coefficients(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the coefficients k, shape (m,), and d k/d theta, shape (m, parameters)."""
        k = np.empty(self.model.coefficients)
        dk = np.empty((len(k), len(self.model.parameters)))
        self._code.bench_once_partials(to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(dk))
        return k, dk

    def rest_state(self, theta: FloatArray, y: FloatArray) -> FloatArray:
        """Return the states, shape (states,), of a bench at rest with the textbook states y[:6]."""
        y, k, z = y.copy(), np.empty(self.model.coefficients), np.empty(READINGS)
        self._code.bench_begin(
            to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(y, (len(self.model.states),)), to_c(z)
        )
        return y

    def window(
        self, k: FloatArray, y: FloatArray, currents: FloatArray, dy: FloatArray, dk: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the readings of a prediction, shape (n, 5), their derivatives, shape (n, 5, p), and the final states.

        `k`, `y`, `currents`: coefficients, states where it begins (not changed), and currents [A], shape (n,). `dy`,
        `dk`: directions: of the held states where it begins, shape (held, a), and of the coefficients, shape (m, b). p
        = a + b, in this order.
        """
        first, y = dy.shape[1], y.copy()
        directions = np.zeros((self.held + len(k), first + dk.shape[1]))
        directions[: self.held, :first], directions[self.held :, first:] = dy, dk
        n, p = len(currents), directions.shape[1]
        z, dz, workspace = np.empty((n, READINGS)), np.empty((n, READINGS, p)), np.empty((self.held, p))
        self._code.bench_sensitivities(
            to_c(k, (self.model.coefficients,)), to_c(y, (len(self.model.states),)), ctypes.c_long(n),
            to_c(currents, (n,)), ctypes.c_long(p), to_c(directions), to_c(z), to_c(dz), to_c(workspace),
        )  # fmt: skip
        return z, dz, y

    def filter_states(
        self,
        k: FloatArray,
        state: FilterState,
        currents: FloatArray,
        readings: FloatArray,
        q: FloatArray,
        r: FloatArray,
    ) -> FloatArray:
        """Return filtered states, shape (n, states); `state` is updated in place.

        `currents`, `readings`: currents [A], shape (n,), and the readings after each, shape (n, 5). `q`: variance that
        a sample adds to each held state for what the model misses, shape (held,). `r`: variance of the readings' noise,
        shape (5,).
        """
        n, held = len(currents), self.held
        states, workspace = np.empty((n, len(self.model.states))), np.empty((2 * held + len(k), held))
        self._code.bench_follow(
            to_c(k, (self.model.coefficients,)), to_c(state.y, (len(self.model.states),)),
            to_c(state.covariance, (held, held)), ctypes.c_long(n), to_c(currents, (n,)), to_c(readings, (n, READINGS)),
            to_c(q, (held,)), to_c(r, (READINGS,)), to_c(states), to_c(workspace),
        )  # fmt: skip
        return states


def estimate_noise(runs: list[Run]) -> FloatArray:
    """Return the noise's standard deviation of the five readings, shape (5,), from differences of samples."""
    squares = [np.mean(np.diff(run.readings, SERIES_ORDER, axis=0) ** 2, axis=0) for run in runs]
    spread = np.sqrt(np.mean(squares, axis=0) / comb(2 * SERIES_ORDER, SERIES_ORDER))
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
        Scale of the model error, in units of `MODEL_ERROR_*`.
    """

    def __init__(self, exact: Sensitivities, theta: FloatArray, noise: FloatArray, trust: float) -> None:
        self.exact, self.theta, self.noise = exact, theta, noise
        self.k, _ = exact.coefficients(theta)
        self.q = (trust * process_noise(exact.model)[: exact.held]) ** 2

    def states(self, run: Run) -> FloatArray:
        """Return the states at every sample of a run, shape (n, states)."""
        state = self._begin(run)
        first = state.y.copy()
        rest = self.exact.filter_states(self.k, state, run.u[:-1], run.readings[1:], self.q, self.noise**2)
        return np.concatenate([first[None], rest])

    def initial_states(self, run: Run, samples: Indices) -> tuple[FloatArray, FloatArray]:
        """Return initial states of windows that begin at `samples` of a run, in ascending order.

        States, shape (n, states), and square roots of their covariances, shape (n, held, held).
        """
        state, at, readings, r = self._begin(run), 0, run.readings, self.noise**2
        held = self.exact.held
        states, roots = np.empty((len(samples), len(state.y))), np.empty((len(samples), held, held))
        scales = np.array([one.scale for one in self.exact.model.states])[:held]
        for i, sample in enumerate(samples):
            self.exact.filter_states(self.k, state, run.u[at:sample], readings[at + 1 : sample + 1], self.q, r)
            at = int(sample)
            states[i], roots[i] = state.y, scales[:, None] * _root(state.covariance / np.outer(scales, scales))
        return states, roots

    def _begin(self, run: Run) -> FilterState:
        model = self.exact.model
        y: FloatArray = np.zeros(len(model.states))
        y[:TEXTBOOK] = run.x[0, [4, 5, 6, 7, 2, 3]]
        y = self.exact.rest_state(self.theta, y)
        spread = np.array([one.scale for one in model.states])[: self.exact.held]
        spread[:3] = 3.0 * self.noise[2:]
        return FilterState(y, np.diag(spread**2))


def process_noise(model: BenchModel) -> FloatArray:
    """Return the process noise, shape (states,): standard deviation per sample at a trust of 1."""
    result = MODEL_ERROR_HIDDEN * np.array([one.scale for one in model.states])
    result[:TEXTBOOK] = 0.0
    result[:2] = MODEL_ERROR_PRESSURE * model.bench.supply_pressure
    result[3] = MODEL_ERROR_VELOCITY * model.bench.stroke
    return result


def _root(covariance: FloatArray) -> FloatArray:
    """A matrix whose product with its own transpose it is."""
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
