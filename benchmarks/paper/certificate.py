# SPDX-License-Identifier: Apache-2.0
"""The paper's filter: eq. cont_require_6 with a network M(x) on the network model, decided at 100 Hz.

M = L L' + eps I, the network gives L row by row; M' is its derivative along x'. A and B are the model network's exact
slopes, where the paper takes differences. v is along f_l with the sign of physics.md's erratum: with the printed one
the correction pushes the force away from its reference.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import NamedTuple

import numpy as np

from benchmarks.paper.network import NetworkModel
from benchmarks.paper.store import PRINTED
from hydro_bridge.signals import CorrectionStatus, FloatArray
from hydro_filter.certificate import closed_form
from hydro_filter.controller.loop_filter import Result
from hydro_filter.model import coordinates
from hydro_filter.model.sample import LOAD_FORCE, STATES, Sample
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench

PERIOD = 10
"""Samples between two decisions: 100 Hz."""
ROWS, COLUMNS = np.tril_indices(STATES)


class Linearization(NamedTuple):
    """A = df/dx, shape (8, 8), B = df/du, shape (8,), and x', shape (8,), SI units."""

    state_matrix: FloatArray
    input_vector: FloatArray
    state_rate: FloatArray


class NetworkDynamics:
    """x' of the network model, with its exact slopes."""

    def __init__(self, model: NetworkModel) -> None:
        self.model = model

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """A, B and x' at state x, shape (8,), and valve current [A]."""
        return Linearization(*self.model.linearized(state, current))


@dataclass(frozen=True)
class NetworkMetric:
    """M(x) on normalized states.

    `layers`: weights and biases of three layers, 8 inputs and 36 outputs. `center`, `scale`: of the model's states,
    shape (8,), SI units.
    """

    layers: tuple[FloatArray, ...]
    center: FloatArray
    scale: FloatArray

    def matrix(self, state: FloatArray) -> FloatArray:
        """M(x), shape (8, 8)."""
        factor, _ = self._factors(state, np.zeros(STATES))
        return factor @ factor.T + float(PRINTED["training_metric"]["epsilon"]) * np.eye(STATES)

    def rate(self, state: FloatArray, state_rate: FloatArray) -> FloatArray:
        """M' [1/s] along x', shape (8, 8)."""
        factor, turned = self._factors(state, state_rate)
        return turned @ factor.T + factor @ turned.T

    def _factors(self, state: FloatArray, state_rate: FloatArray) -> tuple[FloatArray, FloatArray]:
        """L and L'."""
        w1, b1, w2, b2, w3, b3 = self.layers
        value, nudge = (state - self.center) / self.scale, state_rate / self.scale
        for w, b in ((w1, b1), (w2, b2)):
            value, nudge = value @ w + b, nudge @ w
            on = value > 0.0
            value, nudge = value * on, nudge * on
        factors = np.zeros((2, STATES, STATES))
        factors[0][ROWS, COLUMNS], factors[1][ROWS, COLUMNS] = value @ w3 + b3, nudge @ w3
        return factors[0], factors[1]


class ForceLaw:
    """Slope K = du/dx of the law that the box runs on the nominal bench."""

    def __init__(self) -> None:
        bench = Bench.nominal()
        self.constants, self.current_max = bench.constants(), bench.valve_current_max
        self.gain_floor = float(BoxConfig().constants(bench)["gain_floor"][0])

    def gradient(self, sample: Sample) -> FloatArray:
        """K [A per unit of each state], shape (8,)."""
        out = np.empty(STATES)
        gain = sample.proportional_gain
        coordinates.gradient(self.constants, sample.state, sample.nominal_current, gain, self.gain_floor, out)
        return out


class PaperFilter:
    """The filter as the paper has it: lambda 0.1, no dead zone for noise, one decision in `PERIOD` samples.

    M_c = v' (M' + sym(M (A + B K)) + 2 lambda M) v        v = [0, 0, f_l - f_r, 0, ...], of normalized states
    a   = 2 v' M B,  b = -M_c                              a du <= b, the smallest |du| in the valve's rest
    """

    mismatch = ""

    def __init__(self, metric: NetworkMetric, model: NetworkModel) -> None:
        self.metric, self.dynamics, self.law = metric, NetworkDynamics(model), ForceLaw()
        self.scale, self.contraction_rate = model.scale, float(PRINTED["val_cont"]["rate"])
        self.reset()

    def reset(self) -> None:
        """Start again."""
        self._count = 0

    def skip(self) -> None:
        """Samples are missing before the next one."""

    def certificate(self, sample: Sample) -> tuple[float, float]:
        """Return a [1/A/s] and b [1/s] at a sample."""
        v = np.zeros(STATES)
        v[LOAD_FORCE] = (sample.state[LOAD_FORCE] - sample.reference_force) / self.scale[LOAD_FORCE]
        limit, metric = self.law.current_max, self.metric.matrix(sample.state)
        linear = self.dynamics.linearize(sample.state, min(max(sample.nominal_current, -limit), limit))
        moved = self.scale * v
        closed = linear.state_matrix @ moved + linear.input_vector * float(self.law.gradient(sample) @ moved)
        turned = self.metric.rate(sample.state, linear.state_rate) @ v
        drift = float(v @ metric @ (closed / self.scale))
        m_c = float(v @ turned) + 2.0 * drift + 2.0 * self.contraction_rate * float(v @ metric @ v)
        return 2.0 * float(v @ metric @ (linear.input_vector / self.scale)), -m_c

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide, or hold."""
        if self._count % PERIOD == 0:
            self._held = self._decide(sample)
        self._count += 1
        return self._held

    def _decide(self, sample: Sample) -> Result:
        if not all(map(isfinite, (*sample.state, sample.nominal_current))):
            return Result(0.0, nan, nan, CorrectionStatus.NAN)
        a, b = self.certificate(sample)
        limit = self.law.current_max
        applied = min(max(sample.nominal_current, -limit), limit)
        change, status = closed_form(a, b, -limit - applied, limit - applied)
        delta_u = change + (applied - sample.nominal_current) if change else 0.0
        return Result(delta_u, -b, a * change - b, CorrectionStatus(status))
