# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from hydro_bridge.signals import Flag, FloatArray, ReferenceSignal, Waveform
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


class Foreign:
    """Any other plant: what it wraps is stepped from Python as the nodes do."""

    def __init__(self, plant: Plant) -> None:
        self.plant = plant

    def reset(self, seed: int) -> FloatArray:
        return self.plant.reset(seed)

    def step(self, valve_current: float) -> FloatArray:
        return self.plant.step(valve_current)


def test_the_compiled_loop_gives_the_nodes_numbers_to_the_bit(bench: Bench) -> None:
    generator = np.random.default_rng(5)
    schedule = Schedule(
        reference=ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=250.0, frequency=0.7),
        gains=generator.uniform((15.0, 5.0), (90.0, 15.0), (150, 2)),
        seconds=2.0,
        correction=generator.normal(0.0, 1e-4, 2000),
    )
    compiled = simulate(AnalyticPlant(bench), bench, schedule, seed=3)
    stepped = simulate(Foreign(AnalyticPlant(bench)), bench, schedule, seed=3)
    assert compiled.tobytes() == stepped.tobytes()
    assert (compiled["flags"] == Flag.ARMED).all()


def test_fixed_gains_track_on_the_nominal_bench_and_go_unstable_above_it(bench: Bench) -> None:
    def rmse(proportional_gain: float) -> float:
        schedule = Schedule(reference=SINE, gains=(proportional_gain, 15.0), seconds=4.0)
        run = simulate(AnalyticPlant(bench), bench, schedule)
        return float(np.sqrt(np.mean((run["reference_force"] - run["load_force"])[1000:] ** 2)))

    base, best, shaking = rmse(15.0), rmse(90.0), rmse(105.0)
    assert 15.0 < base < 30.0
    assert 2.0 < best < 6.0
    assert shaking > 3.0 * best
