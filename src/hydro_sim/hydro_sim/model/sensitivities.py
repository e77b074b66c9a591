# SPDX-License-Identifier: Apache-2.0
"""Exact sensitivities of a bench model's predictions, and its states from a recording, for `learn`.

::

    exact = Sensitivities(BenchModel(bench))
    k, dk = exact.coefficients(model.values)                 dk: d k/d theta
    z, dz, y = exact.window(k, y, currents, dy, dk[:, free]) readings of a prediction, and their derivatives
    track = exact.follow(k, start, currents, readings, q, r) states at the samples: an extended Kalman filter

Derivatives are forward: any number of directions is propagated with the states, each by the partial derivatives of one
integration step, which come from the model's symbols. With p directions a sample costs its partial derivatives once,
and a multiplication for each of them and each direction.

Past currents (of a dead time) are known exactly: directions and covariances leave them out. `held` is the number of the
other states.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.model.bench_model import READINGS, BenchModel, library, to_c


@dataclass
class Track:
    """State of a filter, updated in place."""

    y: FloatArray
    """States, shape (states,)."""
    covariance: FloatArray
    """Covariance of their error, shape (held, held)."""


class Sensitivities:
    """See the module. Compiles what it needs where it was not compiled yet: 2 to 10 s for a set of effects."""

    def __init__(self, model: BenchModel) -> None:
        self.model = model
        self.held = len(model.states) - model.structure.past
        self._code = library(model.structure, "sensitivities")

    def coefficients(self, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients k, shape (m,), and d k/d theta, shape (m, parameters)."""
        k = np.empty(self.model.coefficients)
        dk = np.empty((len(k), len(self.model.parameters)))
        self._code.bench_once_partials(to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(dk))
        return k, dk

    def begin(self, theta: FloatArray, y: FloatArray) -> FloatArray:
        """States, shape (states,), of a bench that stands still in the textbook states y[:6]."""
        y, k, z = y.copy(), np.empty(self.model.coefficients), np.empty(READINGS)
        self._code.bench_begin(
            to_c(theta, (len(self.model.parameters),)), to_c(k), to_c(y, (len(self.model.states),)), to_c(z)
        )
        return y

    def window(
        self, k: FloatArray, y: FloatArray, currents: FloatArray, dy: FloatArray, dk: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Readings of a prediction, shape (n, 5), their derivatives, shape (n, 5, p), and the states after it.

        `k`, `y`, `currents`: coefficients, states where it begins (not changed), and currents [A], shape (n,). `dy`,
        `dk`: directions: of the held states where it begins, shape (held, a), and of the coefficients, shape (m, b). p
        = a + b, in this order.
        """
        first, y = dy.shape[1], y.copy()
        directions = np.zeros((self.held + len(k), first + dk.shape[1]))
        directions[: self.held, :first], directions[self.held :, first:] = dy, dk
        n, p = len(currents), directions.shape[1]
        z, dz, room = np.empty((n, READINGS)), np.empty((n, READINGS, p)), np.empty((self.held, p))
        self._code.bench_sensitivities(
            to_c(k, (self.model.coefficients,)), to_c(y, (len(self.model.states),)), ctypes.c_long(n),
            to_c(currents, (n,)), ctypes.c_long(p), to_c(directions), to_c(z), to_c(dz), to_c(room),
        )  # fmt: skip
        return z, dz, y

    def follow(
        self, k: FloatArray, track: Track, currents: FloatArray, readings: FloatArray, q: FloatArray, r: FloatArray
    ) -> FloatArray:
        """States, shape (n, states), each from the readings up to it; `track` changes in place.

        `currents`, `readings`: currents [A], shape (n,), and the readings after each, shape (n, 5). `q`: variance that
        a sample adds to each held state for what the model misses, shape (held,). `r`: variance of the readings' noise,
        shape (5,).
        """
        n, held = len(currents), self.held
        states, room = np.empty((n, len(self.model.states))), np.empty((2 * held + len(k), held))
        self._code.bench_follow(
            to_c(k, (self.model.coefficients,)), to_c(track.y, (len(self.model.states),)),
            to_c(track.covariance, (held, held)), ctypes.c_long(n), to_c(currents, (n,)), to_c(readings, (n, READINGS)),
            to_c(q, (held,)), to_c(r, (READINGS,)), to_c(states), to_c(room),
        )  # fmt: skip
        return states
