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


class Watched:
    """A watch, and what it asked for: it sends no gains, commands no law and learns nothing."""

    def __init__(self, rearm: bool = True, *needed: Requirement, override: GainOverride | None = None) -> None:
        self.armings: list[bool] = []
        self.references: list[ReferenceSignal] = []
        self.said: list[str] = []
        self.watch, self.now = PlantSupervisor(self, rearm, needed, override), 0.0

    def reference(self, signal: ReferenceSignal) -> None:
        self.references.append(signal)

    def arm(self, arm: bool) -> None:
        self.armings.append(arm)

    def report(self, sentence: str, warning: bool = False) -> None:
        self.said.append(sentence)

    def run(self, flags: int | None, until: float) -> None:
        """Samples with these flags, or none, and ticks."""
        for tick in range(round(20 * self.now), round(20 * until)):
            if flags is not None:
                self.watch.on_sample(flags, tick / 20)
            self.watch.on_tick(tick / 20)
        self.now = until

    @property
    def may_begin(self) -> bool:
        return self.watch.may_begin(self.now)

    @property
    def asks(self) -> int:
        return sum(HOW_TO_ARM in sentence for sentence in self.said)


class Slow:
    """Something that is ready when it says so."""

    def __init__(self) -> None:
        self.ready = False
        self.requirement = Requirement(
            name="the learner", ready=lambda: self.ready, hint="", within=300.0, missing="the learner never came"
        )


def armed(*, rearm: bool, override: GainOverride | None = None) -> Watched:
    """Armed at 1 s, with all ready before."""
    at = Watched(rearm, override=override)
    at.run(0, 1.0)
    at.run(ARMED, 1.1)
    at.armings.clear()
    at.said.clear()
    return at


def test_a_box_that_trips_whenever_it_is_armed_is_not_armed_again() -> None:
    at, tripped = armed(rearm=True), int(Flag.TRIPPED | Flag.FORCE_LIMIT)
    for trial in range(TRIALS):
        at.now = 2.0 + trial
        at.run(tripped, 2.5 + trial)
        at.run(ARMED, 3.0 + trial)
    with pytest.raises(NotReadyError, match="base gains do not hold this bench"):
        at.run(tripped, 3.0 + TRIALS)


def test_a_plant_that_a_person_disarmed_is_asked_for_now_and_then_until_a_person_arms_it() -> None:
    at = armed(rearm=True)
    at.run(0, 1.3)
    assert at.armings == [False, True]
    at.watch.defer_to_person(1.3)
    at.run(0, 31.0)
    assert at.armings == [False, True]
    at.run(0, 32.0)
    assert at.armings == [False, True, False, True]
    at.watch.defer_to_person(32.0)
    at.run(ARMED, 32.1)
    at.run(0, 32.3)
    assert at.armings == [False, True] * 3


def test_a_plant_that_a_person_arms_before_all_is_ready_is_disarmed() -> None:
    at = Watched(True, Slow().requirement)
    at.run(0, 3.0)
    at.run(ARMED, 3.2)
    assert TOO_EARLY in at.said and at.armings == [False]


def test_arming_waits_for_the_filter() -> None:
    at = Watched()
    at.run(STALE, 20.0)
    assert at.armings == []
    assert at.said == [f"waiting for the filter, 90 s at most: {HOW_TO_GET_A_FILTER}"]
    at.run(0, 20.5)
    assert at.armings == [False, True]
    at.run(ARMED, 20.6)
    assert at.may_begin


def test_without_a_filter_it_is_armed_in_the_end_and_said() -> None:
    at = Watched()
    at.run(STALE, 92.0)
    assert at.armings[:2] == [False, True]
    assert at.said.count(NO_FILTER) == 1
    at.run(STALE | ARMED, 92.1)
    assert at.may_begin


@pytest.mark.parametrize("rearm", [True, False])
def test_nothing_is_armed_before_all_that_will_act_is_ready(rearm: bool) -> None:
    learner = Slow()
    at = Watched(rearm, learner.requirement)
    at.run(0, 60.0)
    assert at.armings == [] and not at.asks
    assert at.watch.summary == "disarmed, waiting for the learner"
    learner.ready = True
    at.run(0, 60.2)
    assert at.armings == ([False, True] if rearm else [])
    assert [HOW_TO_ARM in sentence for sentence in at.said[1:]] == ([] if rearm else [True])


def test_a_persons_word_is_dropped_where_readiness_goes_before_it_is_carried_out() -> None:
    at = Watched(rearm=False)
    at.run(0, 1.0)
    at.watch.arm_now(1.0)
    at.run(STALE, 5.0)
    at.run(0, 9.0)
    assert at.armings == [False] and at.asks == 2, "asked again"


def test_a_filter_that_is_late_for_a_moment_while_the_plant_arms_does_not_undo_it() -> None:
    at = Watched(rearm=False)
    at.run(0, 1.0)
    at.watch.arm_now(1.0)
    at.run(0, 1.15)
    at.run(STALE, 1.2)
    at.run(STALE | ARMED, 1.3)
    assert at.armings == [False, True] and not at.may_begin
    at.run(ARMED, 1.4)
    assert at.armings == [False, True] and at.may_begin


@pytest.mark.parametrize("rearm", [True, False])
def test_a_plant_that_is_found_armed_is_disarmed_before_anything_begins(rearm: bool) -> None:
    at = Watched(rearm)
    at.run(ARMED, 0.5)
    assert at.armings == [False] and at.references == [ReferenceSignal()] and at.said == [TOO_EARLY]
    assert not at.may_begin
    at.run(0, 1.0)
    assert at.armings[1:] == ([False, True] if rearm else [])
    assert rearm or HOW_TO_ARM in at.said[-1]
    at.run(ARMED, 1.1)
    assert at.may_begin


def test_an_armed_plant_on_which_nothing_has_acted_for_a_while_is_disarmed_and_armed_anew() -> None:
    at = armed(rearm=True)
    at.run(ARMED, 1.0 + IDLE)
    assert at.armings == [] and at.may_begin
    at.run(ARMED, 1.3 + IDLE)
    assert at.armings == [False] and not at.may_begin
    assert "while no controller acted: it is disarmed" in at.said[0]
    at.run(0, 1.6 + IDLE)
    assert at.armings == [False, False, True]


def test_a_controller_that_acts_keeps_the_plant_armed_whatever_is_missing() -> None:
    learner = Slow()
    learner.ready = True
    at = Watched(True, learner.requirement)
    at.run(0, 0.5)
    at.armings.clear()
    at.run(ARMED, 0.6)
    learner.ready = False
    for tick in range(12, 200):
        at.watch.note_action(tick / 20)
        at.run(ARMED | (STALE if tick % 3 else 0), (tick + 1) / 20)
    assert at.armings == []


def test_under_gains_that_a_person_holds_a_plant_is_not_idle_but_after_them_it_is() -> None:
    override = GainOverride()
    at = armed(rearm=True, override=override)
    override.hold(60.0, 10.0, 0.0, 1.1)
    at.run(ARMED, 9.0)
    assert at.armings == []
    override.release()
    assert at.watch.blocking_reason(9.0), "nothing acts between the release and the next tick"
    at.run(ARMED, 9.1)
    assert at.armings == [False]


@pytest.mark.parametrize(
    ("flags", "seconds", "sentence"),
    [(None, 601.0, "no samples on /hydro/state"), (0, 301.0, "the learner never came")],
)
def test_every_wait_ends(flags: int | None, seconds: float, sentence: str) -> None:
    at = Watched(True, Slow().requirement)
    with pytest.raises(NotReadyError, match=sentence):
        at.run(flags, seconds)


def test_a_watch_goes_on_where_another_sessions_ends() -> None:
    before = armed(rearm=False)
    before.watch.note_action(2.0)
    for begun, may in ((2.5, True), (9.0, False)):
        at = Watched(rearm=False)
        at.watch.take_over(before.watch)
        at.now = begun
        at.run(ARMED, begun + 0.2)
        assert at.may_begin is may
        assert at.armings == ([] if may else [False]), "it has waited too long in between"


@pytest.mark.parametrize("rearm", [True, False])
def test_calm_is_a_second_armed_without_reference_and_anew_where_the_box_was_disarmed_meanwhile(rearm: bool) -> None:
    at = armed(rearm=rearm)
    assert at.may_begin and at.references == []
    at.watch.calm()
    assert at.watch.calming and at.references == [ReferenceSignal()]
    at.run(ARMED, 1.8)
    at.run(int(Flag.TRIPPED), 2.5)
    assert at.armings == ([False, True] if rearm else []), "calm is waited for armed"
    at.run(ARMED, 3.4)
    assert at.watch.calming and not at.may_begin, "0.9 s armed in a row, whatever was before"
    at.run(ARMED, 3.6)
    assert not at.watch.calming
    assert at.may_begin != rearm, "armed again where no person is needed for it"
    assert at.armings == ([False, True, False] if rearm else [])


def test_a_bypassed_filter_does_not_say_that_its_model_fits_and_is_waited_for_only_if_it_is_gone() -> None:
    at = Watched()
    at.watch.on_correction(CorrectionStatus.MISMATCH)
    at.watch.on_correction(CorrectionStatus.BYPASSED)
    assert at.said == [MISMATCH, UNWATCHED] and not at.watch.mismatched
    at.run(STALE, 0.5)
    assert at.armings == [False, True], "its own log says that it decides nothing"
    at = Watched()
    at.watch.on_correction(CorrectionStatus.BYPASSED)
    at.run(None, 3.0)
    at.run(STALE, 4.0)
    assert True not in at.armings


def test_nothing_begins_while_the_filters_model_is_not_this_benchs_and_each_change_is_told_once() -> None:
    at = Watched()
    for _ in range(3):
        at.watch.on_correction(CorrectionStatus.MISMATCH)
    at.run(STALE, 200.0)
    assert at.armings == [] and NO_FILTER not in at.said, "it has answered"
    at.watch.on_correction(CorrectionStatus.PASS)
    at.run(0, 200.5)
    assert at.armings == [False, True]
    at.run(ARMED, 201.0)
    assert at.may_begin
    at.watch.on_correction(CorrectionStatus.MISMATCH)
    at.run(ARMED | STALE, 201.1)
    assert not at.may_begin
    assert [said for said in at.said if said in (MISMATCH, FITS)] == [MISMATCH, FITS, MISMATCH]
    with pytest.raises(NotReadyError, match="says MISMATCH for 300 s"):
        at.run(ARMED | STALE, 503.0)
