# SPDX-License-Identifier: Apache-2.0
"""Many benches in one loop give the numbers of one bench at a time, to the bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, Command, CorrectionStatus, Flag, ReferenceSignal, Waveform
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.model.sample import Sample
from hydro_policy.envs.environment import Environment
from hydro_policy.envs.vector_env import VectorBench, records, vector_filter
from hydro_policy.task.mdp import GainRange, StepClock, TaskSettings, observe, rewards
from hydro_sim.box.box import Box, BoxConfig, Integral
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate

BENCH = Bench.nominal()
SLOW_CELL = replace(BENCH, load_cell_bandwidth=25.0)
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=250.0, frequency=1.3)
PLANTS = {
    "learned": make_plant,
    "analytic": lambda: AnalyticPlant(BENCH),
    "analytic without noise": lambda: AnalyticPlant(SLOW_CELL, noise=0.0),
}


@pytest.mark.parametrize(("kind", "form"), [*((kind, "bumpless") for kind in PLANTS), ("analytic", "paper")])
def test_every_bench_of_a_fleet_is_the_offline_simulation_to_the_bit(kind: str, form: Integral) -> None:
    """Gains change every step; bench 1 is compared while its neighbors run something else."""
    config, steps, rng = BoxConfig(integral=form), 60, np.random.default_rng(3)
    gains = np.column_stack((rng.uniform(15, 90, steps + 1), rng.uniform(5, 15, steps + 1)))
    schedule = Schedule(reference=SINE, gains=gains, seconds=0.01 * steps)
    want = simulate(PLANTS[kind](), BENCH, schedule, config=config, seed=7)
    fleet = VectorBench([BENCH] * 3, [PLANTS[kind]() for _ in range(3)], config)
    fleet.links["gain_delay"] = 10  # the offline schedule changes gains with the step's own sample
    changes = gains - (15.0, 5.0)
    for index in range(3):
        fleet.reset(index, SINE, 7 if index == 1 else 100 + index, (changes[0, 0], changes[0, 1]))
    got = [fleet.samples[1, -1:].copy()]
    for row in changes[1:]:
        got.append(fleet.step(np.array([[0.0, 0.0], row, [50.0, 5.0]]))[1].copy())
    samples = np.concatenate(got)[: len(want)]
    for name in (*STATE_FIELDS, "time", "sequence", "flags"):
        np.testing.assert_array_equal(samples[name], want[name], err_msg=name)


def test_transitions_are_what_a_session_makes_of_the_same_samples() -> None:
    task = TaskSettings(gains=GainRange(delta_kp_max=60.0))
    environment = Environment(VectorBench([BENCH] * 2, [AnalyticPlant(BENCH) for _ in range(2)]), task)
    environment.reset([SINE, SINE], [1, 2])
    rng, clock, before = np.random.default_rng(0), StepClock(), np.zeros(2)
    last = environment.vector_bench.samples[1, -1:]
    clock.add(0, records(last, STATE_FIELDS)[0], int(Flag.ARMED))
    for _ in range(5):
        np.testing.assert_array_equal(
            environment.observation[1], observe(records(last, STATE_FIELDS)[-1], before, task.size)
        )
        transitions = environment.step(rng.uniform(-1, 1, (2, 2)))
        last, step = transitions.samples[1], None
        for sample, values in zip(last, records(last, STATE_FIELDS), strict=True):
            step = clock.add(int(sample["sequence"]), values, int(sample["flags"])) or step
        assert transitions.reward[1] == pytest.approx(rewards.tracking(task, step.error, step.error_rate), rel=1e-14)
        kp, _ = task.gains.gains(transitions.action[1])
        assert last["proportional_gain"][-1] == 15.0 + kp
        before = transitions.action[1]


def test_a_bench_that_trips_ends_its_transition_and_begins_anew() -> None:
    """K_p = 300 swings up beyond the force limit: terminal, with the penalty; the next step runs from rest."""
    task = TaskSettings(gains=GainRange(delta_kp_max=285.0))
    environment = Environment(VectorBench([BENCH] * 2, [AnalyticPlant(SLOW_CELL) for _ in range(2)]), task)
    environment.reset([SINE, SINE], [0, 1])
    for _ in range(400):
        transitions = environment.step(np.array([[1.0, 0.0], [-1.0, 0.0]]))
        if transitions.terminated.any():
            break
    np.testing.assert_array_equal(transitions.terminated, [True, False])
    assert transitions.reward[0] == -task.trip_penalty
    assert np.isfinite(transitions.rows()).all() and len(transitions.rows()) == 2
    tripped, other = environment.vector_bench.samples[:, -1]["sequence"]
    assert tripped == 0 < other
    following = environment.step(np.array([[-1.0, 0.0], [-1.0, 0.0]]))
    assert not following.terminated.any() and following.samples[0]["sequence"][0] == 1
    following.reward[0] = np.nan
    assert len(following.rows()) == 1 and len(following.rows(1)) == 0, "no other bench's row takes its place"


def test_a_filter_in_the_fleet_is_the_filter_beside_the_box() -> None:
    """With `Box` and the filter as the node runs it, a correction acting one sample late: to the bit."""
    filters = vector_filter("learned", BENCH, 2)
    fleet = VectorBench([BENCH] * 2, [AnalyticPlant(SLOW_CELL) for _ in range(2)], filters=filters)
    for index in range(2):
        fleet.reset(index, SINE, index)
    changes = np.array([[0.0, 0.0], [120.0, 10.0]])
    got = np.concatenate([fleet.samples[1, -1:].copy()] + [fleet.step(changes)[1].copy() for _ in range(40)])
    beside, box, plant = default_filter(BENCH), Box(BENCH), AnalyticPlant(SLOW_CELL)
    box.receive(Command(), 0.0)
    measurement, delta_u = plant.reset(1), 0.0
    for k, sample in enumerate(got):
        kp, ki = changes[min(k, 1)]
        command = Command(arm=True, delta_kp=kp, delta_ki=ki, delta_u=delta_u, reference=SINE, filter_fresh=True)
        box.receive(command, 0.001 * k)
        want = box.tick(measurement, 0.001 * k)
        assert sample["valve_current"] == want["valve_current"] and sample["flags"] == want["flags"], k
        result = beside.correct(Sample.from_record(want))
        assert result.status is not CorrectionStatus.MISMATCH, "which the fleet does not watch for"
        delta_u, measurement = result.delta_u, plant.step(float(want["valve_current"]))
    corrected = np.abs(got["valve_current"] - got["nominal_valve_current"]).max()
    assert corrected > 1e-4, "the learned metric corrects K_p = 135"
