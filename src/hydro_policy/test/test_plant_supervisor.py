# SPDX-License-Identifier: Apache-2.0
"""When a plant is armed: not before all is ready. When something begins on it: not before it is calm, nor once idle."""

from __future__ import annotations

import pytest

from hydro_bridge.safety.readiness import NotReadyError, Requirement
from hydro_core.signals import CorrectionStatus, Flag, ReferenceSignal
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import (
    ARM_HINT,
    EARLY_ARMING_MESSAGE,
    IDLE_TIME_MAX,
    TRIPS_MAX,
    PlantSupervisor,
)

ARMED, STALE, TRIPPED = int(Flag.ARMED), int(Flag.FILTER_STALE), int(Flag.TRIPPED | Flag.FORCE_LIMIT)
OFF, ON = False, True
ANEW = [OFF, ON]
"""How a plant is armed: disarmed first."""


class Watched:
    """A supervisor, what it asked for and what it said; `needs_learner`: once `learner` is set, all is ready."""

    def __init__(
        self, rearm: bool = True, *, needs_learner: bool = False, override: GainOverride | None = None
    ) -> None:
        self.learner, self.now = not needs_learner, 0.0
        self.armings: list[bool] = []
        self.references: list[ReferenceSignal] = []
        self.said: list[str] = []
        learner = Requirement(
            name="the learner",
            ready=lambda: self.learner,
            hint="",
            timeout=300.0,
            timeout_message="the learner never came",
        )
        self.publish_reference, self.arm = self.references.append, self.armings.append
        self.supervisor = PlantSupervisor(self, rearm, [learner], override)

    def report(self, sentence: str, warning: bool = False) -> None:
        self.said.append(sentence)

    def run(self, flags: int | None, until: float) -> list[bool]:
        """Samples with these flags, or none, and ticks; returns the requests to disarm and to arm."""
        before = len(self.armings)
        for tick in range(round(20 * self.now), round(20 * until)):
            if flags is not None:
                self.supervisor.on_sample(flags, tick / 20)
            self.supervisor.on_tick(tick / 20)
        self.now = until
        return self.armings[before:]

    @property
    def may_start(self) -> bool:
        return self.supervisor.may_start(self.now)


def armed(rearm: bool = True, override: GainOverride | None = None) -> Watched:
    """Armed at 1 s, with all ready before."""
    at = Watched(rearm, override=override)
    at.run(0, 1.0)
    at.run(ARMED, 1.1)
    assert at.may_start
    at.said.clear()
    return at


def test_a_box_that_trips_whenever_it_is_armed_is_not_armed_again() -> None:
    at = armed()
    for trial in range(TRIPS_MAX):
        at.now = 2.0 + trial
        at.run(TRIPPED, 2.5 + trial)
        at.run(ARMED, 3.0 + trial)
    with pytest.raises(NotReadyError, match="base gains do not hold this bench"):
        at.run(TRIPPED, 3.0 + TRIPS_MAX)


def test_a_plant_that_a_person_disarmed_is_asked_for_now_and_then_until_a_person_arms_it() -> None:
    at = armed()
    assert at.run(0, 1.3) == ANEW
    at.supervisor.defer_to_person(1.3)
    assert at.run(0, 31.0) == []
    assert at.run(0, 32.0) == ANEW
    at.supervisor.defer_to_person(32.0)
    at.run(ARMED, 32.1)
    assert at.run(0, 32.3) == ANEW


def test_without_a_filter_it_is_armed_in_the_end_and_said() -> None:
    at = Watched()
    assert at.run(STALE, 89.0) == []
    assert len(at.said) == 1 and at.said[0].startswith("waiting for the filter, 90 s at most")
    assert at.run(STALE, 92.0)[:2] == ANEW and sum("the filter does not answer" in one for one in at.said) == 1
    at.run(STALE | ARMED, 92.1)
    assert at.may_start


@pytest.mark.parametrize("rearm", [True, False])
def test_nothing_is_armed_before_all_that_will_act_is_ready(rearm: bool) -> None:
    at = Watched(rearm, needs_learner=True)
    assert at.run(STALE, 30.0) == at.run(0, 60.0) == []
    assert at.supervisor.summary == "disarmed, waiting for the learner" and ARM_HINT not in "".join(at.said)
    assert at.run(ARMED, 60.2) == [OFF] and EARLY_ARMING_MESSAGE in at.said, "a person has armed it before"
    at.learner = True
    assert at.run(0, 62.0)[:2] == (ANEW if rearm else [])
    assert (ARM_HINT in at.said[-1]) is not rearm


def test_a_persons_word_is_dropped_where_readiness_goes_before_it_is_carried_out() -> None:
    at = Watched(rearm=False)
    at.run(0, 1.0)
    at.supervisor.arm_now(1.0)
    at.run(STALE, 5.0)
    at.run(0, 9.0)
    assert at.armings == [OFF] and sum(ARM_HINT in said for said in at.said) == 2, "asked again"


def test_a_filter_that_is_late_for_a_moment_while_the_plant_arms_does_not_undo_it() -> None:
    at = Watched(rearm=False)
    at.run(0, 1.0)
    at.supervisor.arm_now(1.0)
    at.run(0, 1.15)
    at.run(STALE, 1.2)
    at.run(STALE | ARMED, 1.3)
    assert at.armings == ANEW and not at.may_start
    assert at.run(ARMED, 1.4) == [] and at.may_start


@pytest.mark.parametrize("rearm", [True, False])
def test_a_plant_that_is_found_armed_is_disarmed_before_anything_begins(rearm: bool) -> None:
    at = Watched(rearm)
    assert at.run(ARMED, 0.5) == [OFF] and at.references == [ReferenceSignal()] and at.said == [EARLY_ARMING_MESSAGE]
    assert not at.may_start
    assert at.run(0, 1.0) == (ANEW if rearm else [])
    assert rearm or ARM_HINT in at.said[-1]
    at.run(ARMED, 1.1)
    assert at.may_start


def test_an_armed_plant_on_which_nothing_has_acted_for_a_while_is_disarmed_and_armed_anew() -> None:
    at = armed()
    assert at.run(ARMED, 1.0 + IDLE_TIME_MAX) == [] and at.may_start
    assert at.run(ARMED, 1.3 + IDLE_TIME_MAX) == [OFF] and not at.may_start
    assert "while no controller acted: it is disarmed" in at.said[0]
    assert at.run(0, 1.6 + IDLE_TIME_MAX) == ANEW


def test_a_controller_that_acts_keeps_the_plant_armed_whatever_is_missing() -> None:
    at = armed()
    at.learner = False
    for tick in range(22, 200):
        at.supervisor.note_action(tick / 20)
        assert at.run(ARMED | (STALE if tick % 3 else 0), (tick + 1) / 20) == []


def test_under_gains_that_a_person_holds_a_plant_is_not_idle_but_after_them_it_is() -> None:
    override = GainOverride()
    at = armed(override=override)
    override.start(60.0, 10.0, 0.0, 1.1)
    assert at.run(ARMED, 9.0) == []
    override.release()
    assert at.supervisor.blocking_reason(9.0), "nothing acts between the release and the next tick"
    assert at.run(ARMED, 9.1) == [OFF]


@pytest.mark.parametrize(
    ("flags", "seconds", "sentence"),
    [(None, 601.0, "no samples on /hydro/state"), (0, 301.0, "the learner never came")],
)
def test_every_wait_ends(flags: int | None, seconds: float, sentence: str) -> None:
    with pytest.raises(NotReadyError, match=sentence):
        Watched(needs_learner=True).run(flags, seconds)


@pytest.mark.parametrize(("begun", "may"), [(2.5, True), (9.0, False)])
def test_a_watch_goes_on_where_another_sessions_ends_unless_it_has_waited_too_long(begun: float, may: bool) -> None:
    before, at = armed(rearm=False), Watched(rearm=False)
    before.supervisor.note_action(2.0)
    at.supervisor.continue_from(before.supervisor)
    at.now = begun
    assert at.run(ARMED, begun + 0.2) == ([] if may else [OFF]) and at.may_start is may


@pytest.mark.parametrize("rearm", [True, False])
def test_calm_is_a_second_armed_without_reference_and_anew_where_the_box_was_disarmed_meanwhile(rearm: bool) -> None:
    at = armed(rearm)
    assert at.references == []
    at.supervisor.start_recovery()
    assert at.supervisor.recovering and at.references == [ReferenceSignal()]
    at.run(ARMED, 1.8)
    assert at.run(int(Flag.TRIPPED), 2.5) == (ANEW if rearm else []), "calm is waited for armed"
    assert at.run(ARMED, 3.4) == []
    assert at.supervisor.recovering and not at.may_start, "0.9 s armed in a row, whatever was before"
    assert at.run(ARMED, 3.6) == ([OFF] if rearm else [])
    assert not at.supervisor.recovering and at.may_start != rearm, "armed again where no person is needed for it"


def test_a_bypassed_filter_does_not_say_that_its_model_fits_and_is_waited_for_only_if_it_is_gone() -> None:
    at = Watched()
    at.supervisor.on_correction(CorrectionStatus.MISMATCH)
    at.supervisor.on_correction(CorrectionStatus.BYPASSED)
    assert "is not this bench's" in at.said[0] and "bypassed" in at.said[1] and not at.supervisor.mismatched
    assert at.run(STALE, 0.5) == ANEW, "its own log says that it decides nothing"
    at = Watched()
    at.supervisor.on_correction(CorrectionStatus.BYPASSED)
    at.run(None, 3.0)
    assert ON not in at.run(STALE, 4.0)


def test_nothing_begins_while_the_filters_model_is_not_this_benchs_and_each_change_is_told_once() -> None:
    at = Watched()
    for _ in range(3):
        at.supervisor.on_correction(CorrectionStatus.MISMATCH)
    assert at.run(STALE, 200.0) == [] and not any("does not answer" in one for one in at.said), "it has answered"
    at.supervisor.on_correction(CorrectionStatus.PASS)
    assert at.run(0, 200.5) == ANEW
    at.run(ARMED, 201.0)
    assert at.may_start
    at.supervisor.on_correction(CorrectionStatus.MISMATCH)
    at.run(ARMED | STALE, 201.1)
    assert not at.may_start
    said = [sentence for sentence in at.said if sentence.startswith("the filter's model")]
    assert ["fits again" in sentence for sentence in said] == [False, True, False]
    with pytest.raises(NotReadyError, match="says MISMATCH for 300 s"):
        at.run(ARMED | STALE, 503.0)
