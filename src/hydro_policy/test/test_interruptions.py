# SPDX-License-Identifier: Apache-2.0
"""What an interruption leaves behind: nothing that is held against the policy or the run that follows."""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import STATE_FIELDS, Flag
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sac.settings import SacSettings
from hydro_policy.sessions.episode import Phase
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.supervision.monitor import MonitorSettings, SafetyMonitor
from hydro_policy.task.cases import EvaluationSettings, ExamSettings
from hydro_policy.task.mdp import TaskSettings
from hydro_policy.task.step_aggregator import StepClock
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import InlineLearner, OfflineGraph

BENCH = Bench.nominal()
SHORT = TrainingSettings(
    episodes=1,
    warmup_steps=50,
    replay_capacity=4000,
    exam=ExamSettings(every=1, settle=0.5, measure=0.5, repeats=1),
    sac=SacSettings(batch_size=32),
    task=TaskSettings(steps_per_episode=150),
)


def test_monitor_takes_no_current_across_a_gap_for_chatter() -> None:
    """Samples were lost, or a run was interrupted: what lies between two samples is no rate."""
    monitor, clock, sample = SafetyMonitor(MonitorSettings()), StepClock(), np.zeros(14)
    said = []
    for sequence in range(300):
        sample[STATE_FIELDS.index("valve_current")] = 0.01 if sequence // 50 % 2 else -0.01
        done = clock.add(sequence, sample.copy(), int(Flag.ARMED)) if 0 < sequence % 50 < 46 else None
        said += [] if done is None else [monitor.add(done)]
    assert len(said) == 30 and said == [None] * 30 and monitor.chatter == 0.0


class Still:
    """Outputs that nobody hears."""

    def gains(self, delta_kp: float, delta_ki: float, step: int) -> None: ...

    def command_law(self, command: object, step: int) -> None: ...

    def acted(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None: ...

    def reference(self, signal: object) -> None: ...

    def arm(self, arm: bool) -> None: ...

    def say(self, sentence: str, warning: bool = False) -> None: ...


def test_a_run_that_is_begun_anew_is_not_judged_by_what_was_before_it() -> None:
    """The force was far away when a person took the gains, under way in a step."""
    monitor = SafetyMonitor(MonitorSettings())
    session = EvaluationSession(EvaluationSettings(), [FixedGains(90.0, 15.0)], Still(), monitor=monitor)
    sample, armed = np.zeros(14), int(Flag.ARMED)
    session.on_sample(0, sample, 0, 0.0)
    session.on_tick(0.0)
    for sequence in range(1, 400):
        held = 105 <= sequence < 205
        if sequence in (105, 205):
            session.override.hold(60.0, 10.0, 0.0, 0.0) if held else session.override.release()
        sample[STATE_FIELDS.index("load_force")] = 500.0 if 100 < sequence < 205 else 0.0
        session.on_sample(sequence, sample.copy(), armed, 1e-3 * sequence)
    assert session._run is not None and session._run.first == 205
    assert session.scores == [] and 0.0 <= monitor.peak < 1.0


def test_a_trip_under_gains_that_a_person_holds_is_not_held_against_the_policy() -> None:
    graph, learner = OfflineGraph(AnalyticPlant(BENCH), BENCH), InlineLearner(SHORT)
    session = TrainingSession(SHORT, learner, graph)
    graph.run(session, 2.0, learner)
    tripped, sequence = int(Flag.TRIPPED | Flag.FORCE_LIMIT), 100_000
    for phase in (Phase.EVALUATING, Phase.TRAINING):
        assert session.phase is phase
        session.override.hold(20.0, 5.0, 0.0, graph.time)
        session.on_sample(sequence, np.zeros(14), tripped, graph.time)
        assert session.phase is Phase.PAUSED and session.watch.calming
        assert session.progress.rollbacks == session.run.rollbacks_in_a_row == 0
        session.override.release()
        while phase is Phase.EVALUATING and session.phase is not Phase.TRAINING:
            graph.run(session, 0.1, learner)
    assert len(session.run.record.of("exam")) == 1, "the examination began anew and came to its end"
    assert not session.run.record.of("stop")
