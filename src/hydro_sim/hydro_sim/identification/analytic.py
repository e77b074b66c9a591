# SPDX-License-Identifier: Apache-2.0
"""The analytic plant of `hydro_sim.model.hydraulics` rolled out in batches, for comparison with learned models."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim import copies
from hydro_sim.files.recordings import Run
from hydro_sim.jit import njit
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.compiled_equations import equations
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.sensors import Sensors


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
        copies.vector(y, starts[k, : hydraulics.STATES])
        rates = starts[k, hydraulics.STATES :].copy()
        _read(constants[0], y, before)
        for h in range(horizon):
            hydraulics.advance(constants[0], y, currents[k, h], SAMPLE_PERIOD, hydraulics.SUBSTEPS)
            _read(constants[0], y, after)
            _differentiate(memories, before, after, rates)
            measured[k, h, 0], measured[k, h, 2] = after[0], after[1]
            measured[k, h, 4], measured[k, h, 5], measured[k, h, 6] = after[2], after[3], after[4]
            measured[k, h, 1], measured[k, h, 3], measured[k, h, 7] = rates
            copies.vector(before, after)
    return measured
