# SPDX-License-Identifier: Apache-2.0
"""The order of things on the real box and plant: ready, armed, acting; and what an armed wait leaves behind."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.safety.readiness import Requirement
from hydro_bridge.signals import CorrectionStatus, Flag
from hydro_filter.controller.filter import Result
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sac.settings import SacSettings
from hydro_policy.sessions.offline import PASSED, InlineLearner, OfflineGraph
from hydro_policy.sessions.session import Session
from hydro_policy.sessions.training import TrainingSession
from hydro_policy.task.cases import EvaluationSettings, ExamSettings
from hydro_policy.task.mdp import TaskSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

BENCH = Bench.nominal()
OFF_CENTRE = replace(BENCH, effects=({"id": "valve_offset", "parameters": {"current": 5e-5}},))
"""A valve that is not closed at 0 A: an armed wait winds up the integral against it, as against dry friction."""
SHORT = TrainingSettings(
    episodes=1,
    warmup_steps=50,
    replay_capacity=4000,
    exam=ExamSettings(every=0),
    sac=SacSettings(batch_size=32),
    task=TaskSettings(steps_per_episode=150),
)


UNDECIDED = Result(0.0, math.nan, math.nan, CorrectionStatus.STALE)


class Timed(OfflineGraph):
    """Keeps when what happened; the filter decides from `filtered_from` [s] on."""

    def __init__(self, filtered_from: float = 0.0) -> None:
        super().__init__(AnalyticPlant(OFF_CENTRE), BENCH)
        self.filtered_from = filtered_from
        self.armed_at: list[float] = []
        self.disarmed_at: list[float] = []
        self.acted_at: list[float] = []
        self.integral_then: list[float] = []
        """The force law's integral whenever gains went out."""

    def gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        super().gains(delta_kp, delta_ki, step)
        self.acted_at.append(self.time)
        self.integral_then.append(float(self.box.state["integral"][0]))

    def sample(self) -> np.void:
        before = bool(self.box.state["armed"][0])
        self.answer = UNDECIDED if self.time < self.filtered_from else PASSED
        output = super().sample()
        armed = bool(output["flags"] & Flag.ARMED)
        if armed != before:
            (self.armed_at if armed else self.disarmed_at).append(self.time)
        return output

    def wait_armed(self, seconds: float) -> None:
        """Somebody arms by hand, and goes for a coffee."""
        for arm in (False, True):
            self.arm(arm)
            self.sample()
        for _ in range(round(1000 * seconds)):
            self.sample()


def from_when(name: str, graph: OfflineGraph, since: float, within: float = 60.0) -> Requirement:
    missing = f"{name} never came"
    return Requirement(name=name, ready=lambda: graph.time >= since, hint="", within=within, missing=missing)


class SlowLearner(InlineLearner):
    """Compiles until `ready_from` [s] of the graph's time."""

    def __init__(self, graph: OfflineGraph, ready_from: float) -> None:
        super().__init__(SHORT)
        self._graph, self.ready_from = graph, ready_from

    @property
    def ready(self) -> bool:  # type: ignore[override]
        return self._graph.time >= self.ready_from

    @ready.setter
    def ready(self, value: bool) -> None: ...


def training(graph: OfflineGraph, learner: InlineLearner, *requirements: Requirement, rearm: bool = True) -> Session:
    return TrainingSession(SHORT, learner, graph, rearm=rearm, requirements=requirements)


def evaluation(graph: OfflineGraph, _: InlineLearner, *requirements: Requirement, rearm: bool = True) -> Session:
    settings = EvaluationSettings(frequencies=(2.0,), settle=0.5, measure=0.5)
    return EvaluationSession(settings, [FixedGains(90.0, 15.0)], graph, rearm=rearm, requirements=requirements)


SESSIONS = pytest.mark.parametrize("make", [training, evaluation])


@pytest.mark.parametrize("last", ["filter", "learner", "recorder"])
def test_the_plant_is_armed_when_the_last_of_all_is_ready_and_acted_upon_at_once(last: str) -> None:
    at = {name: 3.0 if name == last else 1.0 for name in ("filter", "learner", "recorder")}
    graph = Timed(at["filter"])
    learner = SlowLearner(graph, at["learner"])
    session = training(graph, learner, from_when("the recorder", graph, at["recorder"]))
    graph.run(session, 4.0, learner)
    assert len(graph.armed_at) == 1 and 3.0 <= graph.armed_at[0] < 3.3
    assert graph.armed_at[0] <= graph.acted_at[0] < graph.armed_at[0] + 0.06, "one tick, no waiting armed"


@SESSIONS
def test_a_plant_that_waited_armed_is_in_a_defined_state_when_something_acts(make: Callable[..., Session]) -> None:
    graph, learner = Timed(), InlineLearner(SHORT)
    graph.wait_armed(20.0)
    waited = abs(float(graph.box.state["integral"][0]))
    session = make(graph, learner)
    graph.run(session, 0.5, learner)
    assert len(graph.armed_at) == 2 and graph.disarmed_at[0] < graph.armed_at[1] <= graph.acted_at[0]
    assert abs(graph.integral_then[0]) < 0.05 * waited
