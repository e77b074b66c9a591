# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np

from hydro_bridge.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_DTYPE,
    Command,
    Flag,
    ReferenceSignal,
    StateArray,
    Waveform,
)
from hydro_sim.box.box import Box
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


def stepped(bench: Bench, schedule: Schedule, seed: int) -> StateArray:
    """The same run as the sim node makes it: box and plant called one after the other at each sample."""
    box, plant, output = Box(bench), AnalyticPlant(bench), np.zeros(schedule.samples, STATE_DTYPE)
    box.receive(Command(), 0.0)
    measurement, gains, correction = plant.reset(seed), np.asarray(schedule.gains), schedule.correction
    assert correction is not None
    for k in range(schedule.samples):
        kp, ki = gains[min(k // SAMPLES_PER_STEP, len(gains) - 1)] - (box.config.base_kp, box.config.base_ki)
        command = Command(arm=True, reference=schedule.reference, filter_fresh=True, delta_kp=kp, delta_ki=ki,
                          delta_u=correction[k])  # fmt: skip
        box.receive(command, k * SAMPLE_PERIOD)
        output[k] = box.tick(measurement, k * SAMPLE_PERIOD)
        measurement = plant.step(float(output["valve_current"][k]))
    return output


def test_the_compiled_loop_gives_the_nodes_numbers_to_the_bit(bench: Bench) -> None:
    generator = np.random.default_rng(5)
    schedule = Schedule(
        reference=ReferenceSignal(waveform=Waveform.MULTISINE, amplitude=250.0, frequency=0.7),
        gains=generator.uniform((15.0, 5.0), (90.0, 15.0), (150, 2)),
        seconds=2.0,
        correction=generator.normal(0.0, 1e-4, 2000),
    )
    compiled = simulate(AnalyticPlant(bench), bench, schedule, seed=3)
    assert compiled.tobytes() == stepped(bench, schedule, seed=3).tobytes()
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
