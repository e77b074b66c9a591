# SPDX-License-Identifier: Apache-2.0
"""The compensated law beside the paper's in one evaluation, offline: box, guard, plant and estimator, no ROS."""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from hydro_bridge.serial.frames import BoxLaw
from hydro_bridge.signals import NEUTRAL, Flag, Law
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.controllers import Compensated, FixedGains
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.supervision.override import GainOverride
from hydro_policy.task.cases import EvaluationSettings
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.offline_graph import OfflineGraph

LAW = BoxLaw()


class Heard(OfflineGraph):
    """Keeps the law commands and what was armed under which law."""

    def __init__(self) -> None:
        super().__init__(AnalyticPlant(Bench.nominal()), Bench.nominal())
        self.commanded: list[tuple[float, tuple[float, ...]]] = []
        self.armed: list[tuple[bool, int]] = []

    def command_law(self, command, step):
        super().command_law(command, step)
        self.commanded.append((self.time, command.coefficients))

    def sample(self):
        output = super().sample()
        self.armed.append((bool(output["flags"] & Flag.ARMED), int(self.box.state["law"][0])))
        return output


@cache
def evaluated() -> tuple[Heard, EvaluationSession]:
    graph, live = Heard(), LiveCompensation(LAW)
    controllers = [Compensated(live), FixedGains(90.0, 15.0)]
    settings = EvaluationSettings(frequencies=(1.0, 2.0), measure=1.0)
    session = EvaluationSession(settings, controllers, graph, compensation=live)
    graph.run(session, 60.0, compensation=live)
    return graph, session


def test_the_compensated_law_tracks_far_better_than_the_fixed_gains_of_the_paper_s_law() -> None:
    _, session = evaluated()
    assert session.finished and not session.warnings
    rmse = {(score.controller, score.frequency): score.rmse for score in session.scores}
    print(rmse)
    for frequency in (1.0, 2.0):
        assert rmse["compensated", frequency] < 0.2 * rmse["fixed (90, 15)", frequency]
    assert all(score.held == 0 for score in session.scores)


def test_the_law_changes_once_and_only_while_the_plant_is_disarmed() -> None:
    graph, session = evaluated()
    changes = [(before, now) for before, now in pairwise(graph.armed) if before[1] != now[1]]
    assert changes == [((False, Law.PAPER), (False, Law.COMPENSATED))]
    assert graph.guard.counts.laws_refused == 0
    assert [score.controller for score in session.scores] == 2 * ["fixed (90, 15)"] + 2 * ["compensated"]


def pairs(live: LiveCompensation, steps: range, *, lost: int = -1, flags: int = int(Flag.ARMED)) -> None:
    """Samples of a bench that lags 20 ms behind, both messages of each but of one that is lost."""
    for sequence in range(10 * steps.start + 1, 10 * steps.stop + 1):
        t = 1e-3 * sequence
        if sequence != lost:
            live.on_law_state(sequence, Law.COMPENSATED, 300.0 * math.sin(2.0 * math.pi * t))
        live.on_sample(sequence, 300.0 * math.sin(2.0 * math.pi * (t - 0.02)), flags)


def test_it_learns_the_lag_from_both_messages_of_each_sample() -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(400))
    assert live.command.coefficients[1] == pytest.approx(0.02, rel=0.1) and live.held == 0


@pytest.mark.parametrize("flag", [Flag.SATURATED, Flag.WATCHDOG, Flag.TRIPPED, Flag.SENSOR_FAULT, Flag.FILTER_STALE])
def test_coefficients_hold_under_what_spoils_a_sample_and_while_disarmed(flag: Flag) -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(200))
    before = live.command
    pairs(live, range(200, 250), flags=int(Flag.ARMED | flag))
    pairs(live, range(250, 300), flags=0)
    assert live.command == before != LiveCompensation(LAW).command


def test_frozen_coefficients_hold_until_released() -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(100))
    live.frozen, before = True, live.command
    pairs(live, range(100, 200))
    assert live.command == before and live.health["frozen"] != "no"
    live.frozen = False
    pairs(live, range(200, 300))
    assert live.command != before


class Held(Heard):
    """A person holds (90, 15) from before the law changes until 2 s after."""

    def __init__(self, override: GainOverride) -> None:
        super().__init__()
        self.override, self.gained = override, []

    def gains(self, delta_kp, delta_ki, step):
        self.gained.append((int(self.box.state["law"][0]), delta_kp))
        super().gains(delta_kp, delta_ki, step)


def test_gains_held_by_a_person_are_those_of_the_law_that_acts() -> None:
    override, live = GainOverride(), LiveCompensation(LAW)
    graph = Held(override)
    controllers = [Compensated(live), FixedGains(90.0, 15.0)]
    settings = EvaluationSettings(frequencies=(1.0,), measure=1.0)
    session = EvaluationSession(settings, controllers, graph, override=override, compensation=live)
    while not session.scores:
        graph.run(session, 0.01, compensation=live)
    assert graph.armed[-1] == (True, Law.PAPER), "the law is about to change"
    override.hold(90.0, 15.0, 2.0, graph.time)
    graph.gained.clear()
    graph.run(session, 1.5, compensation=live)
    assert graph.gained and set(graph.gained) <= {(int(Law.PAPER), 75.0), (int(Law.COMPENSATED), 90.0 - LAW.base_kp)}
    graph.run(session, 30.0, compensation=live)
    assert session.finished and session.scores[1].controller == "compensated" and not session.scores[1].stopped


def test_a_plant_that_does_not_take_up_the_law_ends_its_runs() -> None:
    live = LiveCompensation(LAW)
    graph = Heard()
    graph.guard.offer(None)
    controllers = [Compensated(live), FixedGains(90.0, 15.0)]
    session = EvaluationSession(
        EvaluationSettings(frequencies=(1.0,), measure=1.0), controllers, graph, compensation=live
    )
    graph.run(session, 60.0, compensation=live)
    assert session.finished and "does not take up" in session.scores[1].stopped
    assert sum(not before[0] and now[0] for before, now in pairwise(graph.armed)) <= 5


def test_a_lost_message_holds_one_policy_step_and_what_comes_out_of_order_is_paired() -> None:
    live, other = LiveCompensation(LAW), LiveCompensation(LAW)
    pairs(live, range(300), lost=1555)
    assert live.held == 1
    for first in range(1, 3000, 10):
        samples = [1e-3 * sequence for sequence in range(first, first + 10)]
        for sequence, t in enumerate(samples, first):
            other.on_sample(sequence, 300.0 * math.sin(2.0 * math.pi * (t - 0.02)), int(Flag.ARMED))
        for sequence, t in enumerate(samples, first):
            other.on_law_state(sequence, Law.COMPENSATED, 300.0 * math.sin(2.0 * math.pi * t))
    whole = LiveCompensation(LAW)
    pairs(whole, range(300))
    assert np.array_equal(other.command.coefficients, whole.command.coefficients)


def test_a_frozen_estimator_keeps_its_coefficients_into_the_next_run() -> None:
    live = LiveCompensation(LAW)
    pairs(live, range(200))
    live.frozen, before = True, live.command
    live.reset()
    assert live.command == before
    live.frozen = False
    live.reset()
    assert live.command.coefficients == NEUTRAL
