# SPDX-License-Identifier: Apache-2.0
"""The analytic plant of `hydro_sim.model.hydraulics` rolled out in batches, for comparison with learned models."""

from __future__ import annotations

import numpy as np
from numba import prange

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim import copies
from hydro_sim.files.recordings import Run
from hydro_sim.jit import njit
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.model.compiled_equations import equations
from hydro_sim.model.effects.catalogue import label
from hydro_sim.model.sensors import Sensors
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.model import first_guess
from hydro_sim.structured.rollout import differentiate, show


def omitted_terms(bench: Bench) -> str:
    """A sentence that names the bench file's effects and closures, which this model omits.

    Elements with memory (spool, bristles, a dead time) cannot start from a measurement there. Closed-loop simulations
    start at rest and leave nothing out: `hydro_sim.model.plant.AnalyticPlant`.
    """
    names = ", ".join(map(label, bench.terms))
    return f"of the bench file's effects the analytic model's predictions leave out {names}" if names else ""


class AnalyticModel:
    """The equations with the bench file's values.

    States are the structured model's, shape (n, 12), as far as they exist.
    """

    def __init__(self, bench: Bench) -> None:
        self.constants = bench.constants()
        record = Sensors().constants()[0]
        self.memories = np.array([record["force_memory"], record["velocity_memory"]])

    def estimate(self, run: Run) -> FloatArray:
        """The measurements themselves."""
        return first_guess(run, np.arange(len(run)))

    def predict(self, starts: FloatArray, currents: FloatArray) -> FloatArray:
        """x, shape (n, H, 8), under currents [A], shape (n, H)."""
        return np.asarray(_rollout(self.constants, self.memories, starts, np.ascontiguousarray(currents)))


@njit
def _read(bench, y, reading):
    reading[0] = equations.hydraulic_force(bench, y[0], y[1])
    reading[1], reading[2], reading[3], reading[4] = y[4], y[0], y[1], y[2]


@njit(parallel=True)
def _rollout(constants, memories, starts, currents):
    n, horizon = currents.shape
    measured = np.empty((n, horizon, 8))
    for k in prange(n):
        y, before, after = np.empty(hydraulics.STATES), np.empty(5), np.empty(5)
        copies.vector(y, starts[k, :4])
        copies.vector(y[4:], starts[k, 6:8])
        rates = starts[k, STATES:].copy()
        _read(constants[0], y, before)
        for h in range(horizon):
            hydraulics.advance(constants[0], y, currents[k, h], SAMPLE_PERIOD, hydraulics.SUBSTEPS)
            _read(constants[0], y, after)
            differentiate(memories, before, after, rates)
            show(after, rates, measured[k, h])
            copies.vector(before, after)
    return measured
