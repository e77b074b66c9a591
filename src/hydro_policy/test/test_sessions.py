# SPDX-License-Identifier: Apache-2.0
"""Training and evaluation sessions on the real box and the simulated bench, without a graph."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import pytest

from hydro_core.signals import STATE_FIELDS, Command, Flag, FloatArray, ReferenceSignal, Waveform
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.report import best
from hydro_policy.evaluation.runner import REPEATS, SILENCE, Phase, TrialRunner
from hydro_policy.evaluation.trial import Comparison
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sac.settings import SacSettings
from hydro_policy.supervision.plant_supervisor import BASE_GAINS_UNSTABLE, PlantSupervisor, learner_requirement
from hydro_policy.task.cases import EvaluationSettings, ExamSettings
from hydro_policy.task.mdp import StepClock, TaskSettings, rewards
from hydro_policy.training_plan import TrainingPlan, training
from hydro_sim.box.box import BoxConfig
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from hydro_sim.simulation.offline import Schedule, simulate
from tests.offline_graph import InlineLearner, OfflineGraph

BENCH = Bench.nominal()


def short(**task: float) -> TrainingSettings:
    return TrainingSettings(
        episodes=2, learning_starts=100, replay_capacity=4000, sac=SacSettings(batch_size=32),
        exam=ExamSettings(every=0), task=TaskSettings(steps_per_episode=150, **task),  # type: ignore[arg-type]
    )  # fmt: skip


def start(settings: TrainingSettings, *, config: BoxConfig | None = None, record: RunRecord | None = None):
    graph, learner = OfflineGraph(AnalyticPlant(BENCH), BENCH, config=config), InlineLearner(settings)
    supervisor = PlantSupervisor(graph, True, [learner_requirement(lambda: learner.ready)])
    return graph, learner, training(TrainingPlan(settings, learner, graph, record=record), supervisor)


def evaluation(*gains: tuple[float, float], **settings: float) -> tuple[OfflineGraph, TrialRunner[Comparison]]:
    """Of fixed gains, half a second at 2 Hz unless said."""
    asked = EvaluationSettings(**{"frequencies": (2.0,), "settle": 0.5, "measure": 0.5, **settings})  # type: ignore[arg-type]
    graph = OfflineGraph(AnalyticPlant(BENCH), BENCH)
    return graph, TrialRunner(Comparison(asked, [FixedGains(*pair) for pair in gains]), PlantSupervisor(graph, True))


def test_training_runs_its_episodes_and_every_transition_is_what_happened() -> None:
    settings = short()
    graph, learner, session = start(settings)
    graph.run(session, 10.0, learner)
    assert session.phase is Phase.FINISHED and session.plan.progress.episode == 2
    assert session.plan.progress.total_steps == learner.replay.produced == 300
    rows, _ = learner.replay.snapshot()
    observations, following, actions, rewards, terminated = np.split(rows, np.cumsum([13, 13, 2, 1]), axis=1)
    assert not terminated.any(), "an episode's end is a truncation"
    np.testing.assert_array_equal(following[:-1], observations[1:])
    np.testing.assert_array_equal(following[:, -2:], actions)  # o' holds the action just taken
    applied = np.array([settings.task.gains.gains(a) for a in actions])
    np.testing.assert_allclose(applied, np.array(graph.gains_published)[:300, :2], atol=1e-4)
    assert (rewards < 0).all()
    assert [h["whole_steps"] for h in session.plan.progress.history] == [150, 150]
    for signal in graph.references:
        assert signal.waveform is Waveform.SINE
        assert 200 <= signal.amplitude <= 300 and 0.5 <= signal.frequency <= 2.0
    assert learner.updates > 150


def test_curves_and_losses_of_a_run_are_in_its_event_files(tmp_path: Path) -> None:
    graph, learner, session = start(short(), record=RunRecord(tmp_path / "run.json"))
    graph.run(session, 10.0, learner)
    session.plan.record.flush()
    (path,) = (tmp_path / "tensorboard").iterdir()
    for value in (one["force_rmse"] for one in session.plan.progress.history):
        assert b"episode/force_rmse" + b"\x15" + struct.pack("<f", value) in path.read_bytes(), "tag and number"
    assert b"episode/critics_loss" in path.read_bytes()


def test_reward_is_the_paper_s_with_the_page_s_units() -> None:
    error, rate = np.full(10, 30.0), np.full(10, 377.0)
    scaled = TaskSettings(force_rate_scale=3770.0)
    assert rewards.tracking(scaled, error, rate) == pytest.approx(-(100 * 0.1**2 + 4000 * 0.1**2))
    assert TaskSettings().force_rate_scale == pytest.approx(300 * 2 * math.pi * 2)
    assert rewards.tracking(scaled, np.array([20.0, 40.0]), np.array([0.0, 754.0])) == pytest.approx(-41.0), (
        "of the means"
    )


def test_step_falls_on_every_tenth_sequence_number_and_a_gap_spoils_it() -> None:
    clock, sample = StepClock(), np.zeros(14)
    sample[STATE_FIELDS.index("reference_force")] = 5.0
    steps = {s: step for s in range(7, 61) if s not in (23, 40) and (step := clock.add(s, sample, Flag.ARMED))}
    assert list(steps) == [7, 10, 20, 30, 41, 50, 60]  # 40 never came, 41 stands in for it
    assert [s for s, step in steps.items() if step.whole] == [20, 60]
    assert clock.lost == 2
    np.testing.assert_array_equal(steps[20].error, np.full(10, 5.0))
    assert clock.add(60, sample, Flag.ARMED) is None, "the same sample twice"
    held = [clock.add(s, sample, Flag.ARMED | (Flag.FILTER_STALE if s == 65 else 0)) for s in range(61, 81)]
    assert [step.whole for step in held if step] == [False, True]
    sample[STATE_FIELDS.index("proportional_gain")] = 60.0  # a plant that requires no filter: these gains act
    for base, acts in ((None, False), ((15.0, 5.0), True), ((60.0, 0.0), False)):
        steps = [clock.add(clock._last + 1, sample, Flag.ARMED | Flag.FILTER_STALE, base) for _ in range(20)]
        assert [bool(step.hold_flags) for step in steps if step][-1] is not acts


def test_lost_plant_pauses_within_150_ms_and_asks_to_disarm() -> None:
    graph, learner, session = start(short())
    graph.run(session, 1.0, learner)
    assert graph.guard.armed
    session.on_tick(graph.time + 0.09)
    assert session.phase is Phase.TRAINING
    session.on_tick(graph.time + 0.15)
    assert session.phase is Phase.PAUSED and not graph.guard.armed
    assert session.watch.condition == "no plant"


def test_a_trip_is_a_termination_with_penalty() -> None:
    graph, learner, session = start(short(amplitude_min=300.0), config=BoxConfig(load_force_limit=150.0))
    graph.run(session, 2.0, learner)
    rows, _ = learner.replay.snapshot()
    assert rows[:, -1].sum() >= 1
    np.testing.assert_array_equal(rows[rows[:, -1] == 1, -2], -1000.0)
    assert any("force_limit" in sentence for sentence in graph.sentences)


def test_a_run_in_which_other_gains_acted_tells_nothing_of_its_controller() -> None:
    graph, session = evaluation((300.0, 15.0), (40.0, 10.0))
    graph.run(session, session.plan.seconds + 5.0)
    narrowed, own = session.scores
    assert narrowed.stopped.startswith("K_p = 90 and K_i = 15 acted") and np.isnan(narrowed.rmse)
    assert not own.stopped
    assert best(session) == "", "nothing is compared with what did not act"


@pytest.mark.parametrize(("silence", "spoilt", "stopped"), [(0.3, 1, ""), (0.07, 1, ""), (0.3, 3, SILENCE)])
def test_a_run_in_which_the_machine_was_held_up_is_started_again(silence: float, spoilt: int, stopped: str) -> None:
    """The box hears nothing in the first runs: for so long that it trips, or that base gains act."""
    graph, session = evaluation((90.0, 15.0))
    receive, until, hit = graph.box.receive, 0.0, set[int]()

    def hear(command: Command, time: float) -> None:
        nonlocal until
        run = session._run
        if run is not None and run.rows and run.first not in hit and len(hit) < spoilt:
            hit.add(run.first)
            until = time + silence
        if time >= until:
            receive(command, time)

    graph.box.receive = hear  # type: ignore[method-assign]
    graph.run(session, 30.0)
    (score,) = session.scores
    assert score.stopped == stopped and math.isnan(score.rmse) is bool(stopped) and not session.warnings
    again = [sentence for sentence in graph.sentences if "fixed (90, 15) at 2 Hz is started again" in sentence]
    assert len(again) == min(spoilt, REPEATS)
    assert (score.samples, score.held) == ((0, 0) if stopped else (500, 0))


def test_base_gains_without_a_filter_replace_none_but_themselves() -> None:
    """A bench whose metric is of the compensated law alone: its base gains are compared all the same."""
    graph, session = evaluation((15.0, 5.0))
    take = session.on_sample

    def arrive(sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        stale = Flag.FILTER_STALE if session._run is not None else 0  # as the bridge says without corrections
        return take(sequence, sample, flags | stale, now)

    session.on_sample = arrive  # type: ignore[method-assign]
    graph.run(session, 30.0)
    (score,) = session.scores
    assert (score.stopped, score.samples, score.held) == ("", 500, 0) and not session.warnings


def test_a_bench_that_base_gains_do_not_hold_is_not_armed_for_ever() -> None:
    settings = EvaluationSettings(frequencies=(1.0, 2.0), settle=0.5, measure=0.5)
    graph = OfflineGraph(AnalyticPlant(BENCH), BENCH, config=BoxConfig(load_force_limit=0.1))
    session = TrialRunner(Comparison(settings, [FixedGains(90.0, 15.0)]), PlantSupervisor(graph, True))
    trips, take, before = 0, session.on_sample, False

    def arrive(sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        nonlocal trips, before
        trips, before = trips + (before and bool(flags & Flag.TRIPPED)), bool(flags & Flag.ARMED)
        return take(sequence, sample, flags, now)

    session.on_sample = arrive  # type: ignore[method-assign]
    graph.run(session, 60.0)
    assert [score.stopped for score in session.scores][-1] == BASE_GAINS_UNSTABLE and session.finished and trips <= 4


def test_a_controller_that_trips_is_not_held_against_base_gains() -> None:
    settings = EvaluationSettings(frequencies=(1.0, 1.5, 2.0, 2.5), settle=0.5, measure=0.5)
    graph = OfflineGraph(AnalyticPlant(BENCH), BENCH, config=BoxConfig(load_force_limit=100.0))
    session = TrialRunner(Comparison(settings, [FixedGains(90.0, 15.0)]), PlantSupervisor(graph, True))
    graph.run(session, 60.0)
    assert [score.stopped for score in session.scores] == ["tripped (force_limit)"] * 4


def test_a_run_of_which_samples_did_not_arrive_is_started_again_and_the_last_one_is_warned_of() -> None:
    graph, session = evaluation((90.0, 15.0))
    take = session.on_sample

    def arrive(sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        return sequence % 50 != 7 and take(sequence, sample, flags, now)

    session.on_sample = arrive  # type: ignore[method-assign]
    graph.run(session, 30.0)
    assert sum("is started again: 2 % of the samples did not arrive" in told for told in graph.sentences) == REPEATS
    assert session.scores[0].lost == 10 and "2 % of the samples did not arrive" in session.warnings[0]


def test_evaluation_gives_the_rmse_of_the_offline_loop() -> None:
    """The session on a box and plant, against `simulation.offline.simulate` with the same gains: within 3 %."""
    graph, session = evaluation((90.0, 15.0), (40.0, 10.0), frequencies=(1.0, 2.0), settle=2.0, measure=1.0)
    graph.run(session, session.plan.seconds + 5.0)
    assert session.finished and len(session.scores) == 4 and not session.warnings
    for score in session.scores:
        kp, ki = (90.0, 15.0) if "90" in score.controller else (40.0, 10.0)
        assert (score.proportional_gain, score.integral_gain) == pytest.approx((kp, ki))
        sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=score.frequency)
        peer = simulate(AnalyticPlant(BENCH), BENCH, Schedule(reference=sine, gains=(kp, ki), seconds=3.0))
        error = (peer["reference_force"] - peer["load_force"])[2000:]
        assert score.rmse == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.03)
        assert score.lost == score.held == 0 and not score.stopped
    assert len(session.traces[0].states) == 1000
