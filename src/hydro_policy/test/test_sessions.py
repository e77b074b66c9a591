# SPDX-License-Identifier: Apache-2.0
"""Training and evaluation sessions on the real box and the simulated bench, without a graph."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, Command, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_policy.evaluation.report import best
from hydro_policy.evaluation.runner import REPEATS_MAX, WATCHDOG_TRIP_MESSAGE, Phase
from hydro_policy.runs.run_directory import RunRecord
from hydro_policy.supervision.plant_supervisor import BASE_GAINS_UNSTABLE_MESSAGE
from hydro_policy.task.mdp import StepClock, TaskSettings, rewards
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate


def test_training_runs_its_episodes_and_every_transition_and_curve_is_what_happened(train, tmp_path: Path) -> None:
    graph, learner, session = train(record=RunRecord(tmp_path / "run.json"))
    graph.run(session, 10.0, learner)
    progress = session.plan.progress
    assert session.phase is Phase.FINISHED and progress.episode == 2 and learner.status.updates > 150
    assert progress.total_steps == learner.appended == 300
    rows, _ = learner.learner.replay.snapshot()
    observations, following, actions, rewards, terminated = np.split(rows, np.cumsum([13, 13, 2, 1]), axis=1)
    assert not terminated.any(), "an episode's end is a truncation"
    np.testing.assert_array_equal(following[:-1], observations[1:])
    np.testing.assert_array_equal(following[:, -2:], actions)  # o' holds the action just taken
    applied = np.array([TaskSettings().gains.gains(a) for a in actions])
    np.testing.assert_allclose(applied, np.array(graph.gains_published)[:300, :2], atol=1e-4)
    assert (rewards < 0).all()
    assert [episode["whole_steps"] for episode in progress.history] == [150, 150]
    for signal in graph.references:
        assert signal.waveform is Waveform.SINE
        assert 200 <= signal.amplitude <= 300 and 0.5 <= signal.frequency <= 2.0
    session.plan.record.flush()
    (events,) = (path.read_bytes() for path in (tmp_path / "tensorboard").iterdir())
    for episode in progress.history:
        assert b"episode/force_rmse" + b"\x15" + struct.pack("<f", episode["force_rmse"]) in events, "tag and number"
    assert b"episode/critics_loss" in events


def test_reward_is_the_paper_s_with_the_page_s_units() -> None:
    scaled = TaskSettings(force_rate_scale=3770.0)
    reward = rewards.tracking(scaled, np.full(10, 30.0), np.full(10, 377.0))
    assert reward == pytest.approx(-(100 * 0.1**2 + 4000 * 0.1**2))
    assert TaskSettings().force_rate_scale == pytest.approx(300 * 2 * math.pi * 2)
    of_means = rewards.tracking(scaled, np.array([20.0, 40.0]), np.array([0.0, 754.0]))
    assert of_means == pytest.approx(reward)


def test_step_falls_on_every_tenth_sequence_number_and_a_gap_spoils_it() -> None:
    clock, sample = StepClock(), np.zeros(14)
    sample[STATE_FIELDS.index("reference_force")] = 5.0
    steps = {s: step for s in range(7, 61) if s not in (23, 40) and (step := clock.add(s, sample, Flag.ARMED))}
    assert list(steps) == [7, 10, 20, 30, 41, 50, 60]  # 40 never came, 41 stands in for it
    assert [s for s, step in steps.items() if step.whole] == [20, 60] and clock.lost == 2
    np.testing.assert_array_equal(steps[20].error, np.full(10, 5.0))
    assert clock.add(60, sample, Flag.ARMED) is None, "the same sample twice"
    held = [clock.add(s, sample, Flag.ARMED | (Flag.FILTER_STALE if s == 65 else 0)) for s in range(61, 81)]
    assert [step.whole for step in held if step] == [False, True]
    sample[STATE_FIELDS.index("proportional_gain")] = 60.0  # a plant that requires no filter: these gains act
    for base, acts in ((None, False), ((15.0, 5.0), True), ((60.0, 0.0), False)):
        steps = [clock.add(clock._last + 1, sample, Flag.ARMED | Flag.FILTER_STALE, base) for _ in range(20)]
        assert [bool(step.hold_flags) for step in steps if step][-1] is not acts


def test_lost_plant_pauses_within_150_ms_and_asks_to_disarm(train) -> None:
    graph, learner, session = train()
    graph.run(session, 1.0, learner)
    session.on_tick(graph.time + 0.09)
    assert session.phase is Phase.TRAINING and graph.guard.armed
    session.on_tick(graph.time + 0.15)
    assert session.phase is Phase.PAUSED and session.supervisor.condition == "no plant" and not graph.guard.armed


def test_a_trip_is_a_termination_with_penalty(train) -> None:
    graph, learner, session = train(amplitude_min=300.0, config=BoxConfig(load_force_limit=150.0))
    graph.run(session, 2.0, learner)
    rows, _ = learner.learner.replay.snapshot()
    ended = rows[rows[:, -1] == 1]
    assert len(ended) and (ended[:, -2] == -1000.0).all()
    assert any("force_limit" in sentence for sentence in graph.sentences)


def test_a_run_in_which_other_gains_acted_tells_nothing_of_its_controller(compare) -> None:
    graph, session = compare((300.0, 15.0), (40.0, 10.0))
    graph.run(session, session.plan.seconds + 5.0)
    narrowed, own = session.scores
    assert narrowed.stopped.startswith("K_p = 90 and K_i = 15 acted") and np.isnan(narrowed.rmse)
    assert not own.stopped
    assert best(session) == "", "nothing is compared with what did not act"


@pytest.mark.parametrize(
    ("silence", "spoilt", "stopped"), [(0.3, 1, ""), (0.07, 1, ""), (0.3, 3, WATCHDOG_TRIP_MESSAGE)]
)
def test_a_run_in_which_the_machine_was_held_up_is_started_again(compare, silence: float, spoilt: int, stopped) -> None:
    """The box hears nothing in the first runs: for so long that it trips, or that base gains act."""
    graph, session = compare((90.0, 15.0))
    receive, until, hit = graph.box.receive, 0.0, set[int]()

    def hear(command: Command, time: float) -> None:
        nonlocal until
        run = session._run
        if run is not None and run.rows and run.first not in hit and len(hit) < spoilt:
            hit.add(run.first)
            until = time + silence
        if time >= until:
            receive(command, time)

    graph.box.receive = hear
    graph.run(session, 30.0)
    (score,) = session.scores
    assert score.stopped == stopped and math.isnan(score.rmse) is bool(stopped) and not session.warnings
    again = [sentence for sentence in graph.sentences if "fixed (90, 15) at 2 Hz is started again" in sentence]
    assert len(again) == min(spoilt, REPEATS_MAX)
    assert (score.samples, score.held) == ((0, 0) if stopped else (500, 0))


def test_base_gains_without_a_filter_replace_none_but_themselves(compare) -> None:
    """A bench whose metric is of the compensated law alone: its base gains are compared all the same."""
    graph, session = compare((15.0, 5.0))
    take = session.on_sample

    def arrive(sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        stale = Flag.FILTER_STALE if session._run is not None else 0  # as the bridge says without corrections
        return take(sequence, sample, flags | stale, now)

    session.on_sample = arrive
    graph.run(session, 30.0)
    (score,) = session.scores
    assert (score.stopped, score.samples, score.held) == ("", 500, 0) and not session.warnings


def test_a_bench_that_base_gains_do_not_hold_is_not_armed_for_ever(compare) -> None:
    graph, session = compare((90.0, 15.0), config=BoxConfig(load_force_limit=0.1), frequencies=(1.0, 2.0))
    graph.run(session, 60.0)
    assert session.finished and session.scores[-1].stopped == BASE_GAINS_UNSTABLE_MESSAGE
    assert 1 <= graph.sentences.count("plant: tripped (force_limit)") <= 4


def test_a_controller_that_trips_is_not_held_against_base_gains(compare) -> None:
    config = BoxConfig(load_force_limit=100.0)
    graph, session = compare((90.0, 15.0), config=config, frequencies=(1.0, 1.5, 2.0, 2.5))
    graph.run(session, 60.0)
    assert [score.stopped for score in session.scores] == ["tripped (force_limit)"] * 4


def test_a_run_of_which_samples_did_not_arrive_is_started_again_and_the_last_one_is_warned_of(compare) -> None:
    graph, session = compare((90.0, 15.0))
    take = session.on_sample
    session.on_sample = lambda sequence, *sample: sequence % 50 != 7 and take(sequence, *sample)
    graph.run(session, 30.0)
    assert sum("is started again: 2 % of the samples did not arrive" in told for told in graph.sentences) == REPEATS_MAX
    assert session.scores[0].lost == 10 and "2 % of the samples did not arrive" in session.warnings[0]


def test_evaluation_gives_the_rmse_of_the_offline_loop(compare) -> None:
    """The session on a box and plant, against `simulation.offline.simulate` with the same gains: within 3 %."""
    gains = (90.0, 15.0), (40.0, 10.0)
    graph, session = compare(*gains, frequencies=(1.0, 2.0), settle=2.0, measure=1.0)
    graph.run(session, session.plan.seconds + 5.0)
    assert session.finished and not session.warnings and len(session.traces[0].states) == 1000
    bench = Bench.nominal()
    for score, (kp, ki) in zip(session.scores, gains * 2, strict=True):
        assert (score.proportional_gain, score.integral_gain) == pytest.approx((kp, ki))
        sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=score.frequency)
        peer = simulate(AnalyticPlant(bench), bench, Schedule(reference=sine, gains=(kp, ki), seconds=3.0))
        error = (peer["reference_force"] - peer["load_force"])[2000:]
        assert score.rmse == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.03)
        assert score.lost == score.held == 0 and not score.stopped
