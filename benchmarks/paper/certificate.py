# SPDX-License-Identifier: Apache-2.0
"""The paper's filter: eq. cont_require_6 with a network M(x) on the network model, decided at 100 Hz.

M = L L' + eps I, the network gives L row by row; M' is its derivative along x'. A and B are the model network's exact
slopes, where the paper takes differences. v is along f_l with the sign of physics.md's erratum: with the printed one
the correction pushes the force away from its reference.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.paper.network import NetworkModel
from benchmarks.paper.store import PRINTED
from hydro_bridge.signals import FloatArray
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.controller.filter import ContractionFilter, FilterSettings, Result
from hydro_filter.model.dynamics import Linearization
from hydro_filter.model.force_law import ForceLaw
from hydro_filter.model.sample import Sample
from hydro_filter.model.state import STATES
from hydro_sim.model.bench import Bench

PERIOD = 10
"""Samples between two decisions: 100 Hz."""
ROWS, COLUMNS = np.tril_indices(STATES)


class NetworkDynamics:
    """x' of the network model, with its exact slopes. See `hydro_filter.model.dynamics.Dynamics`."""

    def __init__(self, model: NetworkModel) -> None:
        self.model = model

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        """A, B and x' at state x, shape (8,), and valve current [A]."""
        return Linearization(*self.model.linearized(state, current))


@dataclass(frozen=True)
class NetworkMetric:
    """M(x) on normalized states. See `hydro_filter.metric.constant.Metric`.

    Parameters
    ----------
    layers
        Weights and biases of three layers, 8 inputs and 36 outputs.
    center, scale
        Of the model's states, shape (8,), SI units.
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


class AtRate:
    """A filter that decides once in `PERIOD` samples and holds its correction in between."""

    mismatch = ""

    def __init__(self, inner: ContractionFilter) -> None:
        self.inner = inner
        self.reset()

    def reset(self) -> None:
        """Begin anew."""
        self._count = 0

    def skip(self) -> None:
        """Samples are missing before the next one."""

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide, or hold."""
        if self._count % PERIOD == 0:
            self._held = self.inner.correct(sample, age)
        self._count += 1
        return self._held


def paper_filter(metric: NetworkMetric, model: NetworkModel, *, bypass: bool = False) -> AtRate:
    """The filter as the paper has it: lambda 0.1, no dead zone for noise."""
    bench = Bench.nominal()
    settings = FilterSettings(contraction_rate=PRINTED["val_cont"]["rate"], noise_floor=0.0, bypass=bypass)
    certificate = Certificate(
        metric=metric, dynamics=NetworkDynamics(model), controller=ForceLaw(bench), scale=model.scale,
        current_max=bench.valve_current_max, contraction_rate=settings.contraction_rate, noise_floor=0.0,
    )  # fmt: skip
    return AtRate(ContractionFilter(certificate, settings))
