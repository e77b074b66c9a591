# SPDX-License-Identifier: Apache-2.0
"""When a plant is armed: not before all is ready. When something begins on it: not before it is calm, nor once idle."""

from __future__ import annotations

import pytest

from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.signals import CorrectionStatus, Flag, ReferenceSignal
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import (
    FITS,
    HOW_TO_ARM,
    HOW_TO_GET_A_FILTER,
    IDLE,
    MISMATCH,
    NO_FILTER,
    TOO_EARLY,
    TRIALS,
    UNWATCHED,
    PlantSupervisor,
)

ARMED, STALE = int(Flag.ARMED), int(Flag.FILTER_STALE)


class Heard:
    """Outputs that keep what was asked for: a watch sends no gains, commands no law and learns nothing."""

    def __init__(self) -> None:
        self.armings: list[bool] = []
        self.references: list[ReferenceSignal] = []
        self.said: list[str] = []

    def reference(self, signal: ReferenceSignal) -> None:
        self.references.append(signal)

    def arm(self, arm: bool) -> None:
        self.armings.append(arm)

    def say(self, sentence: str, warning: bool = False) -> None:
        self.said.append(sentence)


class Slow:
    """Something that is ready when it says so."""

    def __init__(self) -> None:
        self.ready = False
        self.requirement = Requirement(
            name="the learner", ready=lambda: self.ready, hint="", within=300.0, missing="the learner never came"
        )


@pytest.fixture
def heard() -> Heard:
    return Heard()


def run(watch: PlantSupervisor, flags: int, start: float, end: float) -> None:
    for tick in range(round(20 * start), round(20 * end)):
        watch.on_sample(flags, tick / 20)
        watch.on_tick(tick / 20)


def armed_watch(heard: Heard, *, rearm: bool, override: GainOverride | None = None) -> PlantSupervisor:
    """Armed at 1 s, with all ready before."""
    watch = PlantSupervisor(heard, rearm, override=override)
    run(watch, 0, 0.0, 1.0)
    run(watch, ARMED, 1.0, 1.1)
    heard.armings.clear()
    heard.said.clear()
    return watch


def test_a_box_that_trips_whenever_it_is_armed_is_not_armed_again() -> None:
    watch, tripped = armed_watch(Heard(), rearm=True), int(Flag.TRIPPED | Flag.FORCE_LIMIT)
    for trial in range(TRIALS):
        run(watch, tripped, 2.0 + trial, 2.5 + trial)
        run(watch, ARMED, 2.5 + trial, 3.0 + trial)
    with pytest.raises(NotReadyError, match="base gains do not hold this bench"):
        run(watch, tripped, 2.0 + TRIALS, 3.0 + TRIALS)


def test_a_plant_that_a_person_disarmed_is_asked_for_now_and_then_until_a_person_arms_it(heard: Heard) -> None:
    watch = armed_watch(heard, rearm=True)
    run(watch, 0, 1.1, 1.3)
    assert heard.armings == [False, True]
    watch.defer_to_person(1.3)
    run(watch, 0, 1.3, 31.0)
    assert heard.armings == [False, True]
    run(watch, 0, 31.0, 32.0)
    assert heard.armings == [False, True, False, True]
    watch.defer_to_person(32.0)
    run(watch, ARMED, 32.0, 32.1)
    run(watch, 0, 32.1, 32.3)
    assert heard.armings == [False, True] * 3


def test_a_plant_that_a_person_arms_before_all_is_ready_is_disarmed() -> None:
    heard, learner = Heard(), Slow()
    watch = PlantSupervisor(heard, True, [learner.requirement])
    run(watch, 0, 0.0, 3.0)
    run(watch, ARMED, 3.0, 3.2)
    assert TOO_EARLY in heard.said and heard.armings == [False]


def test_arming_waits_for_the_filter(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=True)
    run(watch, STALE, 0.0, 20.0)
    assert heard.armings == []
    assert heard.said == [f"waiting for the filter, 90 s at most: {HOW_TO_GET_A_FILTER}"]
    run(watch, 0, 20.0, 20.5)
    assert heard.armings == [False, True]
    run(watch, ARMED, 20.5, 20.6)
    assert watch.may_begin(20.6)


def test_without_a_filter_it_is_armed_in_the_end_and_said(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=True)
    run(watch, STALE, 0.0, 92.0)
    assert heard.armings[:2] == [False, True]
    assert heard.said.count(NO_FILTER) == 1
    run(watch, STALE | ARMED, 92.0, 92.1)
    assert watch.may_begin(92.1)


@pytest.mark.parametrize("rearm", [True, False])
def test_nothing_is_armed_before_all_that_will_act_is_ready(rearm: bool) -> None:
    heard, learner = Heard(), Slow()
    watch = PlantSupervisor(heard, rearm, [learner.requirement])
    run(watch, 0, 0.0, 60.0)
    assert heard.armings == [] and not any(HOW_TO_ARM in sentence for sentence in heard.said)
    assert watch.summary == "disarmed, waiting for the learner"
    learner.ready = True
    run(watch, 0, 60.0, 60.2)
    assert heard.armings == ([False, True] if rearm else [])
    assert [HOW_TO_ARM in sentence for sentence in heard.said[1:]] == ([] if rearm else [True])


def test_a_persons_word_is_dropped_where_readiness_goes_before_it_is_carried_out(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=False)
    run(watch, 0, 0.0, 1.0)
    watch.arm_now(1.0)
    run(watch, STALE, 1.0, 5.0)
    run(watch, 0, 5.0, 9.0)
    assert heard.armings == [False]
    assert sum(HOW_TO_ARM in sentence for sentence in heard.said) == 2, "asked again"


def test_a_filter_that_is_late_for_a_moment_while_the_plant_arms_does_not_undo_it(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=False)
    run(watch, 0, 0.0, 1.0)
    watch.arm_now(1.0)
    run(watch, 0, 1.0, 1.15)
    run(watch, STALE, 1.15, 1.2)
    run(watch, STALE | ARMED, 1.2, 1.3)
    assert heard.armings == [False, True] and not watch.may_begin(1.3)
    run(watch, ARMED, 1.3, 1.4)
    assert heard.armings == [False, True] and watch.may_begin(1.4)


@pytest.mark.parametrize("rearm", [True, False])
def test_a_plant_that_is_found_armed_is_disarmed_before_anything_begins(heard: Heard, rearm: bool) -> None:
    watch = PlantSupervisor(heard, rearm)
    run(watch, ARMED, 0.0, 0.5)
    assert heard.armings == [False] and heard.references == [ReferenceSignal()] and heard.said == [TOO_EARLY]
    assert not watch.may_begin(0.5)
    run(watch, 0, 0.5, 1.0)
    assert heard.armings[1:] == ([False, True] if rearm else [])
    assert rearm or HOW_TO_ARM in heard.said[-1]
    run(watch, ARMED, 1.0, 1.1)
    assert watch.may_begin(1.1)


def test_an_armed_plant_on_which_nothing_has_acted_for_a_while_is_disarmed_and_armed_anew(heard: Heard) -> None:
    watch = armed_watch(heard, rearm=True)
    run(watch, ARMED, 1.1, 1.0 + IDLE)
    assert heard.armings == [] and watch.may_begin(1.0 + IDLE)
    run(watch, ARMED, 1.0 + IDLE, 1.3 + IDLE)
    assert heard.armings == [False] and not watch.may_begin(1.3 + IDLE)
    assert "while no controller acted: it is disarmed" in heard.said[0]
    run(watch, 0, 1.3 + IDLE, 1.6 + IDLE)
    assert heard.armings == [False, False, True]


def test_a_controller_that_acts_keeps_the_plant_armed_whatever_is_missing() -> None:
    heard, learner = Heard(), Slow()
    learner.ready = True
    watch = PlantSupervisor(heard, True, [learner.requirement])
    run(watch, 0, 0.0, 0.5)
    heard.armings.clear()
    run(watch, ARMED, 0.5, 0.6)
    learner.ready = False
    for tick in range(12, 200):
        watch.acted(tick / 20)
        run(watch, ARMED | (STALE if tick % 3 else 0), tick / 20, (tick + 1) / 20)
    assert heard.armings == []


def test_under_gains_that_a_person_holds_a_plant_is_not_idle_but_after_them_it_is() -> None:
    heard, override = Heard(), GainOverride()
    watch = armed_watch(heard, rearm=True, override=override)
    override.hold(60.0, 10.0, 0.0, 1.1)
    run(watch, ARMED, 1.1, 9.0)
    assert heard.armings == []
    override.release()
    assert watch.unready(9.0), "nothing acts between the release and the next tick"
    run(watch, ARMED, 9.0, 9.1)
    assert heard.armings == [False]


@pytest.mark.parametrize(
    ("flags", "seconds", "sentence"),
    [(None, 601.0, "no samples on /hydro/state"), (0, 301.0, "the learner never came")],
)
def test_every_wait_ends(flags: int | None, seconds: float, sentence: str) -> None:
    watch = PlantSupervisor(Heard(), True, [Slow().requirement])
    with pytest.raises(NotReadyError, match=sentence):
        for tick in range(round(20 * seconds)):
            if flags is not None:
                watch.on_sample(flags, tick / 20)
            watch.on_tick(tick / 20)


def test_a_watch_goes_on_where_another_sessions_ends(heard: Heard) -> None:
    before = armed_watch(heard, rearm=False)
    before.acted(2.0)
    watch = PlantSupervisor(heard, False)
    watch.take_over(before)
    run(watch, ARMED, 2.5, 2.7)
    assert watch.may_begin(2.7) and heard.armings == []
    late = PlantSupervisor(heard, False)
    late.take_over(before)
    run(late, ARMED, 9.0, 9.1)
    assert heard.armings == [False], "it has waited too long in between"


@pytest.mark.parametrize("rearm", [True, False])
def test_calm_is_a_second_armed_without_reference_and_anew_where_the_box_was_disarmed_meanwhile(
    heard: Heard, rearm: bool
) -> None:
    watch = armed_watch(heard, rearm=rearm)
    assert watch.may_begin(1.1) and heard.references == []
    watch.calm()
    assert watch.calming and heard.references == [ReferenceSignal()]
    run(watch, ARMED, 1.1, 1.8)
    run(watch, int(Flag.TRIPPED), 1.8, 2.5)
    assert heard.armings == ([False, True] if rearm else []), "calm is waited for armed"
    run(watch, ARMED, 2.5, 3.4)
    assert watch.calming and not watch.may_begin(3.4), "0.9 s armed in a row, whatever was before"
    run(watch, ARMED, 3.4, 3.6)
    assert not watch.calming
    assert watch.may_begin(3.6) != rearm, "armed again where no person is needed for it"
    assert heard.armings == ([False, True, False] if rearm else [])


def test_a_bypassed_filter_does_not_say_that_its_model_fits_and_is_waited_for_only_if_it_is_gone(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=True)
    watch.on_correction(CorrectionStatus.MISMATCH)
    watch.on_correction(CorrectionStatus.BYPASSED)
    assert heard.said == [MISMATCH, UNWATCHED] and not watch.mismatched
    run(watch, STALE, 0.0, 0.5)
    assert heard.armings == [False, True], "its own log says that it decides nothing"
    heard = Heard()
    watch = PlantSupervisor(heard, rearm=True)
    watch.on_correction(CorrectionStatus.BYPASSED)
    for tick in range(60):
        watch.on_tick(tick / 20)
    run(watch, STALE, 3.0, 4.0)
    assert True not in heard.armings


def test_nothing_begins_while_the_filters_model_is_not_this_benchs_and_each_change_is_told_once(heard: Heard) -> None:
    watch = PlantSupervisor(heard, rearm=True)
    for _ in range(3):
        watch.on_correction(CorrectionStatus.MISMATCH)
    run(watch, STALE, 0.0, 200.0)
    assert heard.armings == [] and NO_FILTER not in heard.said, "it has answered"
    watch.on_correction(CorrectionStatus.PASS)
    run(watch, 0, 200.0, 200.5)
    assert heard.armings == [False, True]
    run(watch, ARMED, 200.5, 201.0)
    assert watch.may_begin(201.0)
    watch.on_correction(CorrectionStatus.MISMATCH)
    run(watch, ARMED | STALE, 201.0, 201.1)
    assert not watch.may_begin(201.1)
    assert [said for said in heard.said if said in (MISMATCH, FITS)] == [MISMATCH, FITS, MISMATCH]
    with pytest.raises(NotReadyError, match="says MISMATCH for 300 s"):
        run(watch, ARMED | STALE, 201.1, 503.0)
