# SPDX-License-Identifier: Apache-2.0
"""When a plant is armed: not before the filter's corrections reach it. When something begins: not before it is calm."""

from __future__ import annotations

from hydro_bridge.signals import CorrectionStatus, Flag, ReferenceSignal
from hydro_policy.watch import AWAITING_FILTER, FITS, MISMATCH, NO_FILTER, PlantWatch


class Heard:
    """Outputs that keep what was asked for."""

    def __init__(self) -> None:
        self.armings: list[bool] = []
        self.references: list[ReferenceSignal] = []
        self.said: list[str] = []

    def gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        raise AssertionError("a watch sends no gains")

    def reference(self, signal: ReferenceSignal) -> None:
        self.references.append(signal)

    def arm(self, arm: bool) -> None:
        self.armings.append(arm)

    def say(self, sentence: str, warning: bool = False) -> None:
        self.said.append(sentence)


def run(watch: PlantWatch, flags: int, start: float, end: float) -> None:
    for tick in range(round(20 * start), round(20 * end)):
        watch.on_sample(flags, tick / 20)
        watch.on_tick(tick / 20)


def test_arming_waits_for_the_filter() -> None:
    heard = Heard()
    watch = PlantWatch(heard, rearm=True)
    run(watch, int(Flag.FILTER_STALE), 0.0, 20.0)
    assert heard.armings == []
    assert AWAITING_FILTER in heard.said
    run(watch, 0, 20.0, 20.5)
    assert heard.armings == [False, True]
    run(watch, int(Flag.ARMED), 20.5, 20.6)
    assert watch.may_begin(20.6)


def test_without_a_filter_it_is_armed_in_the_end_and_said() -> None:
    heard = Heard()
    watch = PlantWatch(heard, rearm=True)
    run(watch, int(Flag.FILTER_STALE), 0.0, 92.0)
    assert heard.armings[:2] == [False, True]
    assert heard.said.count(NO_FILTER) == 1
    run(watch, int(Flag.FILTER_STALE | Flag.ARMED), 92.0, 92.1)
    assert watch.may_begin(92.1)


def test_a_person_who_arms_waits_as_well() -> None:
    heard = Heard()
    watch = PlantWatch(heard, rearm=False)
    run(watch, int(Flag.FILTER_STALE), 0.0, 1.0)
    watch.arm_now(1.0)
    run(watch, int(Flag.FILTER_STALE), 1.0, 5.0)
    assert heard.armings == [False]
    run(watch, 0, 5.0, 5.1)
    assert heard.armings == [False, True]


def test_calm_is_a_second_armed_without_reference_and_anew_where_the_box_was_disarmed_meanwhile() -> None:
    heard, armed = Heard(), int(Flag.ARMED)
    watch = PlantWatch(heard, rearm=True)
    run(watch, armed, 0.0, 1.0)
    assert watch.may_begin(1.0) and heard.references == []
    watch.calm()
    assert watch.calming and heard.references == [ReferenceSignal()]
    run(watch, armed, 1.0, 1.8)
    run(watch, int(Flag.TRIPPED), 1.8, 2.5)
    assert heard.armings == [False, True], "calm is waited for armed"
    run(watch, armed, 2.5, 3.4)
    assert watch.calming and not watch.may_begin(3.4), "0.9 s armed in a row, whatever was before"
    run(watch, armed, 3.4, 3.6)
    assert not watch.calming and watch.may_begin(3.6)


def test_nothing_begins_while_the_filters_model_is_not_this_benchs_and_each_change_is_told_once() -> None:
    heard = Heard()
    watch = PlantWatch(heard, rearm=True)
    for _ in range(3):
        watch.on_correction(CorrectionStatus.MISMATCH)
    run(watch, int(Flag.FILTER_STALE), 0.0, 200.0)
    assert True not in heard.armings, "it is not waited for: it has answered"
    run(watch, int(Flag.ARMED | Flag.FILTER_STALE), 200.0, 202.0)
    assert not watch.may_begin(202.0)
    watch.on_correction(CorrectionStatus.PASS)
    run(watch, int(Flag.ARMED), 202.0, 204.0)
    assert watch.may_begin(204.0) and [said for said in heard.said if said in (MISMATCH, FITS)] == [MISMATCH, FITS]
