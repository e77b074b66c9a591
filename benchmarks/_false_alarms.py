# SPDX-License-Identifier: Apache-2.0
"""The filter's watch on its model while nothing is wrong: many benches that were learned, under all that it holds."""

from __future__ import annotations

import numpy as np
from numba import njit

from benchmarks._truth_fleet import truth_fleet
from hydro_bridge.cli.console import Table, progress
from hydro_bridge.signals import (
    PLANT_FIELDS,
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
    Waveform,
)
from hydro_filter.controller import innovations
from hydro_filter.controller.innovations import COUNT, EQUATIONS
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.model import observer
from hydro_filter.model.loop import memories
from hydro_filter.validation.cases import CASES
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.envs.vector_filter import fleet_filter
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench

GAINS = ("wide", "wide-slow", "switched-slow", "switched", "unstable-slow", "high", "stable", "base")
"""Cases of `validate`, in turn: K_p from -40 to 300."""
BENCHES = 48


def references(rng: np.random.Generator, count: int) -> list[ReferenceSignal]:
    """Sines, multisines, steps and holds within +-350 N and 3 Hz."""
    kinds = (Waveform.SINE, Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP, Waveform.HOLD)
    return [
        ReferenceSignal(
            waveform=kinds[i % len(kinds)], amplitude=float(rng.uniform(10.0, 300.0)),
            offset=float(rng.uniform(-50.0, 50.0)), frequency=float(rng.uniform(0.2, 3.0)),
        )
        for i in range(count)
    ]  # fmt: skip


@njit
def _watch(loop, monitors, memories, x, currents, highest):
    """Samples of all benches: x (benches, n, 8), currents (benches, n)."""
    alarms = 0
    for i in range(len(x)):
        m = monitors[i]
        for k in range(x.shape[1]):
            observer.settle(loop, memories[i], x[i, k], currents[i, k], 0.0)
            innovations.update(loop.model, 1.0, m, x[i, k], memories[i].hidden)
            observer.follow(loop, memories[i], x[i, k], currents[i, k], 0.0)
            for j in range(COUNT):
                highest[j] = max(highest[j], m.sums[j, 0], m.sums[j, 1])
            alarms += m.broken != 0
            m.broken = 0
    return alarms


def alarms(minutes: float, seed: int) -> Table:
    """The table, of both plants."""
    columns = {"plant": "", "minutes": "of bench time", "alarms": "samples", "tripped": "benches"}
    sums = dict.fromkeys(EQUATIONS, "largest sum; 50 is told")
    table = Table(columns | sums, title="Nothing is wrong: false alarms")
    for plant in ("emulator", "sim"):
        table.add(plant=plant, **run(plant, minutes, seed))
    return table


def run(plant: str, minutes: float, seed: int) -> dict[str, float]:
    """So many minutes of bench time, over `BENCHES` benches with a noise, a reference and gains of their own."""
    rng, bench = np.random.default_rng(seed), Bench.nominal()
    fleet = (
        truth_fleet(BENCHES)
        if plant == "emulator"
        else VectorBench([bench] * BENCHES, [make_plant() for _ in range(BENCHES)])
    )
    fleet.filters = fleet_filter("learned", bench, BENCHES)
    steps = max(round(60.0 * minutes / BENCHES / (SAMPLES_PER_STEP * SAMPLE_PERIOD)), 1)
    gains = np.stack([CASES[GAINS[i % len(GAINS)]].draw(seed * BENCHES + i, steps / 100.0) for i in range(BENCHES)])
    changes = gains - (fleet.config.base_kp, fleet.config.base_ki)
    for i, signal in enumerate(references(rng, BENCHES)):
        fleet.begin(i, signal, seed * BENCHES + i)
    loop, monitors, followed = default_filter(bench).parts.loop, innovations.monitors(BENCHES), memories(BENCHES)
    highest, alarms = np.zeros(COUNT), 0
    tripped = np.zeros(BENCHES, bool)
    for k in progress(range(steps), label=f"no alarm, {plant}", unit="step"):
        samples = fleet.step(changes[:, k])
        alarms += _watch(loop, monitors, followed, *_read(samples), highest)
        tripped |= (samples["flags"][:, -1] & int(Flag.TRIPPED)) != 0
    spent = steps * BENCHES * SAMPLES_PER_STEP * SAMPLE_PERIOD / 60.0
    sums = dict(zip(EQUATIONS, highest.tolist(), strict=True))
    return {"minutes": spent, "alarms": alarms, "tripped": int(tripped.sum()), **sums}


def _read(samples: StateArray) -> tuple[FloatArray, FloatArray]:
    x = np.stack([samples[name] for name in PLANT_FIELDS], axis=-1)
    return x, np.ascontiguousarray(samples["valve_current"])
