# SPDX-License-Identifier: Apache-2.0
"""A bench outside of the emulator's equations (`benchmarks.foreign_truth`), as a plant to train on.

Seals that rub with the pressure, a cogging force and flow forces at the valve's edges: none of them is in the shipped
model, in the box's bench.yaml, or among the emulator's effects. So there is a gap between simulation and bench that
is no mere value of a constant.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from benchmarks.foreign_truth.bench import Numbers, numbers
from benchmarks.foreign_truth.box import sense
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, STATES
from benchmarks.foreign_truth.plant import NONE, advance
from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_sim.model.sensors import Sensors

SUBSTEPS = 50
START = 6e6
"""Pa, of chamber A at rest."""
OUTSIDE = {
    "seal_friction": 1.5e-6, "cogging": 8.0, "flow_force": 5e-9, "spool_bandwidth": 110.0, "spool_damping": 0.9,
}  # fmt: skip
"""What differs from bench.yaml."""


class ForeignPlant:
    """See `hydro_sim.model.plant.Plant`; sensors as the emulator's: noise, encoder, rates of the same age.

    Parameters
    ----------
    bench
        The truth.
    noise
        Scale of the sensors' noise and quantisation, 0 or more.
    """

    def __init__(self, bench: Numbers | None = None, *, noise: float = 1.0) -> None:
        self.bench = bench or numbers(**OUTSIDE)
        record = Sensors().constants(noise)[0]
        force, pressure = float(record["force_noise"]), float(record["pressure_noise"])
        self._deviations = np.array([force, force, pressure, pressure])
        self._quantum = float(record["position_step"])
        self._memory = np.array([record["force_memory"], record["velocity_memory"]])
        self.reset(0)

    def reset(self, seed: int) -> FloatArray:
        """See `hydro_sim.model.plant.Plant.reset`."""
        self._generator, self._samples = np.random.default_rng(seed), 0
        self._state, self._work, self._row = np.zeros(STATES), np.zeros((3, STATES)), np.zeros(9)
        self._state[PRESSURE_A], self._state[PRESSURE_B] = START, START / self.bench.area_ratio
        self._state[POSITION] = self.bench.spring_rest_position
        self._sense(self._row)
        return self._row[:8].copy()

    def step(self, valve_current: float) -> FloatArray:
        """See `hydro_sim.model.plant.Plant.step`."""
        _sample(self.bench, self._samples * SAMPLE_PERIOD, valve_current, self._state, self._work)
        self._samples += 1
        now = np.zeros(9)
        self._sense(now)
        for place, memory in ((0, self._memory[0]), (2, self._memory[0]), (6, self._memory[1])):
            raw = (now[place] - self._row[place]) / SAMPLE_PERIOD
            now[place + 1] = memory * self._row[place + 1] + (1.0 - memory) * raw
        self._row = now
        return now[:8].copy()

    def _sense(self, row: FloatArray) -> None:
        sense(self.bench, self._state, self._deviations * self._generator.standard_normal(4), self._quantum, row)


@njit
def _sample(bench, time, current, state, work):
    """One millisecond under a held current."""
    step = 1e-3 / SUBSTEPS
    for j in range(SUBSTEPS):
        advance(NONE, bench, time + j * step, current, state, step, work)
