# SPDX-License-Identifier: Apache-2.0
"""The emulated bench as a plant of `envs.vector_env`, what it tracks, and truths drawn about the default one.

Many truth plants in one compiled loop; import registers them. Benchmarks alone may do this: no package may import the
truth (emulator.md).

What is drawn, independently: spring 0.5 to 2.5 times, supply 0.65 to 1.05 times, valve gain +-25 %, leak, dry friction
and its rise at standstill, spool, load cell 15 to 40 Hz, mass, and, each on a share of the benches, overlap, lopsided
valve, air. They are the range in which a lab's bench is likely to lie, not the emulator's default with noise on it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from hydro_core.signals import FADE_TIME, SAMPLE_PERIOD, SAMPLES_PER_STEP, Flag, FloatArray
from hydro_core.valve_overlap import OVERLAP_EFFECT
from hydro_policy.compensation.estimator import Compensator
from hydro_policy.compensation.residual import Residual
from hydro_policy.envs import vector_env, vector_runs
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task import recorded
from hydro_policy.task.cases import Case, EvaluationSettings
from hydro_sim.box.firmware import reference_force
from hydro_sim.emulator.truth import plant as truth
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.model.bench import Bench


class Truth(NamedTuple):
    """Rows of `TruthPlant`."""

    parameters: npt.NDArray[np.void]
    differentiation: npt.NDArray[np.void]
    state: npt.NDArray[np.void]
    chain: npt.NDArray[np.void]
    x: npt.NDArray[np.float64]
    work: npt.NDArray[np.float64]
    felt: npt.NDArray[np.float64]
    """The load's own force [N], in front of its cell, of the last ten samples, shape (n, 10)."""
    count: npt.NDArray[np.int64]


@overload(vector_env.advance)
def _advance(plants, i, noise, current):
    if getattr(plants, "instance_class", None) is not Truth:
        return None

    def advance(plants, i, noise, current):
        one = slice(i, i + 1)
        truth.advance_sample(
            plants.parameters[one], plants.differentiation[one], plants.state[one], plants.chain[one], plants.work,
            noise, current,
        )  # fmt: skip
        plants.x[i] = plants.chain[i].measurement
        plants.felt[i, plants.count[i] % SAMPLES_PER_STEP] = plants.state[i].load_force
        plants.count[i] += 1

    return advance


def _rows(plants: Sequence[TruthPlant]) -> Truth:
    records = {name: np.concatenate([getattr(plant, name) for plant in plants]) for name in Truth._fields[:4]}
    count = len(plants)
    return Truth(
        **records, x=np.zeros((count, 8)), work=np.zeros((3, 9)), felt=np.zeros((count, SAMPLES_PER_STEP)),
        count=np.zeros(count, np.int64),
    )  # fmt: skip


def _copy(arrays: Truth, index: int, plant: TruthPlant) -> None:
    for name in Truth._fields[:4]:
        getattr(arrays, name)[index] = getattr(plant, name)[0]
    arrays.x[index] = plant.measurement()


vector_env.PLANT_TYPES[TruthPlant] = (_rows, _copy)


def truth_fleet(truths: Sequence[TruthConfig], overlap: float = 0.0) -> VectorBench:
    """Emulated benches; the boxes believe in the nominal bench with this share of the overlap that each has."""
    believed = []
    for one in truths:
        band = one.effects.valve_deadband
        known = {"id": OVERLAP_EFFECT, "parameters": {"half_width": overlap * (band.half_width if band else 0.0)}}
        believed.append(replace(Bench.nominal(), effects=(known,) if overlap else ()))
    return VectorBench(believed, [TruthPlant(one) for one in truths])


def drawn_truths(count: int, seed: int) -> dict[str, dict[str, Any]]:
    """Contents of so many truth files, by their names."""
    generator = np.random.default_rng(seed)

    def even(low: float, high: float) -> float:
        return float(generator.uniform(low, high))

    def by_ratio(low: float, high: float) -> float:
        return math.exp(even(math.log(low), math.log(high)))

    drawn = {}
    for number in range(count):
        effects: dict[str, Any] = {
            "spring_stiffness": {"ratio": by_ratio(0.5, 2.5)},
            "supply_pressure": {"ratio": even(0.65, 1.05)},
            "valve_gain": {"ratio": by_ratio(0.75, 1.25)},
            "leakage_internal": {"coefficient": by_ratio(2e-14, 1e-12)},
            "friction_coulomb": {"form": "lugre", "force": by_ratio(3.0, 45.0)},
            "friction_stribeck": {"breakaway_force": even(0.0, 15.0)},
            "valve_lag": {"bandwidth": by_ratio(60.0, 200.0), "damping": even(0.6, 1.0), "rate_limit": 3.0},
            "sensor_lag": {"bandwidth": by_ratio(15.0, 40.0), "damping": even(0.5, 0.9)},
            "moving_mass": {"mass": even(-0.4, 3.0)},
        }
        if generator.random() < 0.5:
            effects["valve_deadband"] = {"half_width": even(0.0, 8e-4)}
        if generator.random() < 0.5:
            effects["valve_gain_asymmetry"] = {"ratio": by_ratio(0.8, 1.25)}
        if generator.random() < 0.3:
            effects["entrained_air"] = {"volume_fraction": even(0.0, 0.01)}
        drawn[f"truth_{number:03d}"] = {"profile": "default", "effects": effects}
    return drawn


def tracked(
    fleet: VectorBench, cases: Sequence[Case], controller: vector_runs.VectorController, settings: EvaluationSettings,
    compensator: Compensator | None = None, residual: Residual | None = None, *, seed: int = 0,
) -> list[dict[str, Any]]:  # fmt: skip
    """Run bench i of a fleet with case i; a row of figures for each, over whole periods behind settling.

    rmse and true_rmse are of the measured force and of the load's own [N]; where the box tripped, the RMS of the
    reference as it plays it.
    """
    sums, tripped = np.zeros((5, len(cases))), np.zeros(len(cases), bool)
    before = fleet.samples["valve_current"][:, -1]
    for step in vector_runs.run(fleet, cases, controller, settings, seed, compensator, residual):
        wanted, current = step.samples["reference_force"], step.samples["valve_current"]
        rate = np.diff(current, axis=1, prepend=before[:, np.newaxis]) / SAMPLE_PERIOD
        before = current[:, -1].copy()
        errors = wanted - step.samples["load_force"], wanted - fleet.rows.felt
        for row, signal in enumerate((*errors, rate, wanted)):
            sums[row] += np.sum(np.where(step.counted, signal, 0.0) ** 2, axis=1)
        sums[4] += step.counted.sum(axis=1)
        tripped |= np.any(step.samples["flags"] & Flag.TRIPPED, axis=1)
    rows = []
    for case, figures, trip in zip(cases, np.sqrt(sums[:4] / sums[4]).T.tolist(), tripped.tolist(), strict=True):
        rmse, felt, rate, whole = figures
        if trip:
            rmse = felt = whole = float(np.sqrt(np.mean(_played(case, settings) ** 2)))
        rows.append({"reference": case.name, "rmse": rmse, "true_rmse": felt, "current_rate_rms": rate,
                     "reference_rms": whole, "tripped": trip})  # fmt: skip
    return rows


def _played(case: Case, settings: EvaluationSettings) -> FloatArray:
    """The reference [N] as a box plays it behind settling."""
    if not case.segments:
        return reference_force(case.signal, np.arange(settings.settle, settings.duration(case), SAMPLE_PERIOD))[0]
    fade = SAMPLE_PERIOD * np.arange(recorded.SEGMENT_SAMPLES)
    rising = recorded.BLEND(fade / FADE_TIME)
    parts, leaving = [], np.zeros(len(fade))
    for signal in (case.signal, *case.segments):
        parts.append(leaving + rising * (reference_force(signal, fade)[0] - leaving))
        leaving = reference_force(signal, FADE_TIME + fade)[0]
    return np.concatenate(parts)[round(settings.settle / SAMPLE_PERIOD) :]


def yielding(truths: Mapping[str, Mapping[str, Any]], seed: int) -> dict[str, dict[str, Any]]:
    """The same truths with a Bouc-Wen element beside each spring: 30 to 300 N, which yields at 1 to 10 mm."""
    generator = np.random.default_rng((seed, 1))
    made = {}
    for name, contents in truths.items():
        force, deflection = np.exp(generator.uniform(np.log((30.0, 1e-3)), np.log((300.0, 1e-2)))).tolist()
        element = {"force": force, "deflection": deflection, "exponent": float(generator.uniform(1.0, 3.0))}
        made[name] = {**contents, "outside": {**contents.get("outside", {}), "spring_hysteresis": element}}
    return made
