# SPDX-License-Identifier: Apache-2.0
"""A run of the benchmark: fourth-order Runge-Kutta at 4096 Hz, the measured force a sample late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.hybrid_simulation import entries, plant
from benchmarks.hybrid_simulation.criteria import CRITERIA, criteria
from benchmarks.hybrid_simulation.entries import ACTS, BOX, BOX_EVERY, Entry
from benchmarks.hybrid_simulation.motions import STEP
from benchmarks.hybrid_simulation.plant import Actuator, Specimen
from hydro_core.signals import SAMPLES_PER_STEP, FloatArray
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.residual import AdaptedLaw, Network, Residual
from hydro_sim.jit import njit

NOISE = np.sqrt(np.array((6.25e-14, 1.16e-3)) / STEP)
"""Standard deviation of the measured displacement [m] and force [N], of powers [m^2/Hz], [N^2/Hz]."""

LOST = 15e-3
"""m, target from which on a run is unstable: twice as far as the actuator's 8900 N move the specimen."""


@dataclass(frozen=True, kw_only=True)
class Run:
    """What was recorded at every sample."""

    simulated: FloatArray
    """x_n [m], shape (n, 3)."""
    true: FloatArray
    measured: FloatArray
    """x and x_m [m], shape (n,)."""
    stable: bool
    """Whether the target stayed within `LOST`; else the records end there."""


def run(
    name: str, number: int, actuator: Actuator, specimen: Specimen, ground: FloatArray, rng: np.random.Generator
) -> Run:
    """Run an entry on a building.

    Parameters
    ----------
    name
        One of `entries.ENTRIES`.
    number
        Of the building.
    actuator, specimen
        The plant.
    ground
        Acceleration [m/s^2] at every half step, shape (2 n + 1,).
    rng
        Of the sensors' noise.
    """
    entry, structure = entries.entry(name, actuator, specimen), plant.numerical_substructure(number, specimen)
    count = len(ground) // 2
    noise = rng.standard_normal((count, 2)) * NOISE
    state, records = np.zeros(plant.STATES), np.zeros((count, plant.FLOORS + 3))
    parts = structure, actuator, specimen, entry, ground, noise, state, records
    stable = _advance(*parts, 0, count) if entry.kind != BOX else _adapted(_law(name), entry, parts)
    return Run(simulated=records[:, :plant.FLOORS], true=records[:, plant.FLOORS],
               measured=records[:, plant.FLOORS + 1], stable=bool(stable))  # fmt: skip


def _law(name: str) -> AdaptedLaw:
    estimator = Compensator(1)
    scale = estimator.settings.force_scale
    return AdaptedLaw(estimator, Residual(1, Network.load(), scale) if name == "compensated_residual" else None)


def _adapted(law: AdaptedLaw, entry: Entry, parts: tuple[Any, ...]) -> bool:
    """Run our box, whose law the host adapts after every ten samples; False: the run is lost."""
    box, count = entry.box, len(parts[-1])
    for first in range(0, count, BOX_EVERY * SAMPLES_PER_STEP):
        acts, last = first + BOX_EVERY * (ACTS - 1), first + BOX_EVERY * SAMPLES_PER_STEP
        if not _advance(*parts, first, min(acts, count)):
            return False
        box.wanted[:] = law.coefficients[0]
        if not _advance(*parts, acts, min(last, count)):
            return False
        commanded, measured, rate, reference = box.samples[:, np.newaxis].copy()
        law.step(commanded, measured, np.array([True]), rate, reference)
    return True


def reference_response(number: int, specimen: Specimen, ground: FloatArray) -> FloatArray:
    """Return x_r [m] of the whole building with its specimen, shape (n, 3), for `ground` as in `run`."""
    return _respond(plant.reference_structure(number, specimen), specimen, ground)


def scores(outcome: Run, reference: FloatArray) -> dict[str, Any]:
    """Return the criteria and `stable` of a run; if the error is as large as the target, it is not, and has none."""
    if outcome.stable:
        found = criteria(outcome.simulated, outcome.true, outcome.measured, reference)
        if found["j2_true"] < 100.0:
            return found | {"stable": True}
    return dict.fromkeys(CRITERIA) | {"stable": False}


@njit
def _advance(structure, actuator, specimen, entry, ground, noise, state, records, first, last):
    """Samples from `first` to before `last`; False: the target is beyond `LOST`, or no number."""
    slopes, point = np.empty((4, plant.STATES)), np.empty(plant.STATES)
    for k in range(first, last):
        feedback = records[k - 1, plant.FLOORS + 2] + noise[k - 1, 1] if k > 0 else 0.0
        measured = state[plant.POSITION] + noise[k, 0]
        command = entries.command(entry, k, state[plant.X], measured)
        for i in range(plant.FLOORS):
            records[k, i] = state[plant.X + i]
        records[k, plant.FLOORS], records[k, plant.FLOORS + 1] = state[plant.POSITION], measured
        records[k, plant.FLOORS + 2] = plant.acting_force(actuator, state[plant.FORCE])
        for stage in range(4):
            share = (0.0, 0.5, 0.5, 1.0)[stage]
            for i in range(plant.STATES):
                point[i] = state[i] + share * STEP * slopes[stage - 1, i] if stage > 0 else state[i]
            acceleration = ground[2 * k + (stage + 1) // 2]
            plant.floor_rates(structure, point, acceleration, feedback, slopes[stage])
            plant.plant_rates(actuator, specimen, point, command, slopes[stage])
        for i in range(plant.STATES):
            state[i] += STEP / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
        if not abs(state[plant.X]) < LOST:
            return False
    return True


@njit
def _respond(structure, specimen, ground):
    count = len(ground) // 2
    state, slopes, point = np.zeros(plant.STATES), np.zeros((4, plant.STATES)), np.empty(plant.STATES)
    response = np.zeros((count, plant.FLOORS))
    for k in range(count):
        for i in range(plant.FLOORS):
            response[k, i] = state[plant.X + i]
        for stage in range(4):
            share = (0.0, 0.5, 0.5, 1.0)[stage]
            for i in range(plant.STATES):
                point[i] = state[i] + share * STEP * slopes[stage - 1, i] if stage > 0 else state[i]
            force = plant.spring_force(specimen, point[plant.X], point[plant.HYSTERESIS])
            plant.floor_rates(structure, point, ground[2 * k + (stage + 1) // 2], force, slopes[stage])
            slopes[stage, plant.HYSTERESIS] = plant.hysteresis_rate(specimen, point[plant.HYSTERESIS], point[plant.V])
        for i in range(plant.STATES):
            state[i] += STEP / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    return response
