# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.safety.guard import (
    KEPT_WHILE_ARMED,
    MISMATCHED,
    NOT_OFFERED,
    STALE_LAW,
    CommandGuard,
    GuardSettings,
    safe_command,
)  # fmt: skip
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import NEUTRAL, Command, CorrectionStatus, Law, LawCommand, ReferenceSignal, Waveform

anything = st.floats(allow_nan=True, allow_infinity=True)
LIMITS = GuardSettings()


def fresh(**settings: object) -> CommandGuard:
    guard = CommandGuard(settings=GuardSettings(**settings))  # type: ignore[arg-type]
    guard.set_gains(30.0, 4.0, 0.0)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 77, 0.0)
    return guard


@given(st.lists(st.tuples(anything, anything, anything, st.integers(0, 8), st.floats(0, 1)), max_size=20))
def test_whatever_comes_in_what_goes_down_is_finite_and_within_limits(inputs):
    guard = CommandGuard()
    for kp, ki, u, status, now in sorted(inputs, key=lambda entry: entry[-1]):
        guard.set_gains(kp, ki, now)
        guard.set_correction(u, status, 1, now)
        command = guard.command(now)
        assert all(map(isfinite, (command.delta_kp, command.delta_ki, command.delta_u)))
        assert LIMITS.delta_kp_min <= command.delta_kp <= LIMITS.delta_kp_max
        assert LIMITS.delta_ki_min <= command.delta_ki <= LIMITS.delta_ki_max
        assert abs(command.delta_u) <= LIMITS.delta_u_max


@given(anything, anything, anything, anything)
def test_whatever_reference_comes_in_what_goes_down_is_fit(amplitude, offset, frequency, phase):
    guard = CommandGuard()
    signal = ReferenceSignal(
        waveform=Waveform.SINE, amplitude=amplitude, offset=offset, frequency=frequency, phase=phase
    )
    taken = guard.set_reference(signal)
    down = guard.command(0.0).reference
    assert down == (signal if taken else ReferenceSignal())
    assert all(map(isfinite, (down.amplitude, down.offset, down.frequency, down.phase)))
    assert down.amplitude + abs(down.offset) <= LIMITS.reference_force_max
    assert guard.counts.references_refused == (not taken)


def test_stale_correction_gives_base_gains_no_correction_and_is_told_once():
    guard = fresh()
    assert guard.command(0.02).filter_fresh and not guard.command(0.0201).filter_fresh
    assert not guard.take_events(), "nothing is told of a plant that is not armed"
    guard.counts.stale_correction = 0
    guard.set_arm(True)
    for now in (0.0201, 0.03, 0.04):
        command = guard.command(now)
        assert (command.delta_kp, command.delta_ki, command.delta_u) == (0.0, 0.0, 0.0) and not command.filter_fresh
    assert guard.counts.stale_correction == 3
    assert list(guard.take_events()) == [
        "no correction for 20 ms: base gains, no correction; does the filter run, is the machine overloaded?"
    ]
    guard.set_correction(0.0, CorrectionStatus.PASS, 78, 0.05)
    assert guard.command(0.05).delta_kp == 30.0
    assert guard.take_events() == {"corrections are fresh again": False}, "the end of a trouble is none"


def test_a_correction_acts_for_three_samples_while_the_gains_that_it_allows_go_on():
    guard = fresh()
    assert [guard.command(now).delta_u for now in (0.001, 0.003, 0.0031, 0.019)] == [0.01, 0.01, 0.0, 0.0]
    assert guard.command(0.019).delta_kp == 30.0 and guard.command(0.019).filter_fresh
    assert list(guard.take_events()) == []


def test_a_correction_of_a_sample_that_is_too_old_does_not_act_however_lately_it_came():
    guard = CommandGuard()
    guard.set_gains(30.0, 4.0, 0.0)
    guard.note_sample(82)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 80, 0.0)
    assert guard.command(0.0).delta_u == 0.01
    guard.note_sample(83)
    assert guard.command(0.0).delta_u == 0.0 and guard.command(0.0).delta_kp == 30.0


def test_stale_gains_give_base_gains_and_keep_the_correction():
    guard = CommandGuard()
    guard.set_arm(True)
    guard.set_gains(30.0, 4.0, 0.0)
    guard.set_correction(0.01, CorrectionStatus.PASS, 300, 0.3)
    command = guard.command(0.3)
    assert (command.delta_kp, command.delta_ki, command.delta_u) == (0.0, 0.0, 0.01)
    assert guard.counts.stale_gains == 1
    assert list(guard.take_events()) == ["no gains for 200 ms: base gains are in force"]
    guard = fresh()
    assert guard.command(0.3).delta_kp == 0.0 and not guard.take_events(), "nobody is to act on it while disarmed"


def test_what_is_not_decided_or_not_finite_is_dropped_and_counted_and_the_last_value_ages_on():
    for status in (CorrectionStatus.NAN, CorrectionStatus.STALE, CorrectionStatus.BYPASSED):
        guard = fresh()
        guard.set_correction(0.0, status, 90, 0.021)
        assert not guard.command(0.021).filter_fresh and guard.counts.undecided == 1
    for bad in (nan, inf, -inf):
        guard = fresh()
        guard.set_gains(bad, 1.0, 0.01)
        guard.set_gains(1.0, bad, 0.01)
        guard.set_correction(bad, CorrectionStatus.PASS, 80, 0.01)
        assert guard.command(0.01).delta_kp == 30.0 and guard.counts.not_finite == 3
        assert not guard.command(0.0201).filter_fresh
        assert next(iter(guard.take_events())) == "gains are not finite: dropped, the ones before hold"


def test_out_of_range_is_clamped_counted_and_told_once():
    guard = fresh()
    for now in (0.0, 0.005, 0.01):
        guard.set_gains(1e6, -3.0, now)
    assert guard.command(0.01).delta_kp == 75.0 and guard.command(0.01).delta_ki == 0.0
    assert guard.counts.clamped == 6
    assert list(guard.take_events()) == ["delta_kp is outside [0, 75]: clamped", "delta_ki is outside [0, 10]: clamped"]


def test_without_the_filter_gains_pass_only_if_that_was_asked_for_and_the_flag_says_so():
    guard = CommandGuard(settings=GuardSettings(require_filter=False))
    guard.set_gains(30.0, 4.0, 0.0)
    command = guard.command(0.01)
    assert (command.delta_kp, command.delta_u) == (30.0, 0.0) and not command.filter_fresh


def test_a_correction_of_an_old_sample_is_no_fresh_one_however_lately_it_came():
    for newest, corrects, fresh_ in ((100, 100, True), (120, 100, True), (121, 100, False), (5, 6, False)):
        guard = CommandGuard()
        guard.note_sample(newest)
        guard.set_correction(0.01, CorrectionStatus.PASS, corrects, 1.0)
        assert guard.command(1.0).filter_fresh is fresh_
        assert guard.counts.outdated == (not fresh_)
    guard.note_sample(3)  # the count of samples wraps
    guard.set_correction(0.01, CorrectionStatus.PASS, 2**32 - 3, 1.0)
    assert guard.command(1.0).filter_fresh


def test_gains_that_never_come_back_disarm_and_stop_the_reference_once_and_say_so():
    guard = fresh()
    sine = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0)
    guard.set_arm(True)
    guard.set_reference(sine)
    assert guard.command(1000.0).arm, "none came since the arming: it is by hand"
    guard.set_gains(30.0, 4.0, 1000.0)
    assert (guard.command(1010.0).arm, guard.command(1010.0).reference) == (True, sine)
    guard.take_events()
    for now in (1010.1, 1010.2):
        assert guard.command(now) == Command(corrects=77)
    sentence = "no gains for 10 s, whoever chose them is gone; reference 0 N, disarmed until it is armed again"
    assert list(guard.take_events()) == [sentence] and guard.given_up == sentence and guard.counts.given_up == 1
    guard.set_gains(30.0, 4.0, 1010.3)
    assert not guard.command(1010.3).arm, "gains alone arm nothing"
    guard.set_arm(True)
    assert guard.command(1100.0).arm and guard.given_up == "", "armed on purpose, and nobody has chosen gains since"
    guard = CommandGuard(settings=GuardSettings(gains_timeout=2.0))
    guard.set_arm(True)
    for now in (0.0, 2.0, 4.0):
        guard.set_gains(30.0, 4.0, now)
        assert guard.command(now + 1.9).arm
    guard.set_arm(False)
    guard.command(100.0)
    assert guard.given_up == "", "a plant that is disarmed has nothing to give up"


def test_a_reference_is_refused_as_a_box_would_and_a_hold_goes_down_with_a_frequency_that_every_box_takes():
    guard, changes = CommandGuard(), ({"frequency": 1e-60}, {"phase": 1e60}, {"phase": -1e39})
    for change in changes:  # unfit as float32
        assert not guard.set_reference(replace(ReferenceSignal(waveform=Waveform.SINE, amplitude=10.0), **change))
    assert guard.counts.references_refused == len(changes)
    for frequency in (0.0, -1.0, 1e6, 1e-60):
        assert guard.set_reference(ReferenceSignal(waveform=Waveform.HOLD, offset=100.0, frequency=frequency))
        assert guard.command(0.0).reference == ReferenceSignal(offset=100.0)


def opened() -> CommandGuard:
    """Opened wide by name, wide gains in force, a correction of 10 mA for the newest sample, 50."""
    guard = CommandGuard(settings=GuardSettings(delta_kp_min=-55.0, delta_kp_max=285.0, delta_ki_max=95.0))
    guard.set_gains(235.0, 50.0, 0.0)
    guard.note_sample(50)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 50, 0.0)
    return guard


def test_a_filter_whose_model_is_not_this_benchs_leaves_narrow_gains_and_no_correction():
    guard = opened()
    assert guard.command(0.0) == Command(delta_kp=235.0, delta_ki=50.0, delta_u=0.01, corrects=50, filter_fresh=True)
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 50, 0.001)
    assert guard.command(0.001) == Command(delta_kp=75.0, delta_ki=10.0, corrects=50, filter_fresh=False)
    assert not guard.correction_fresh(0.001) and guard.counts.narrowed == guard.counts.mismatched == 1
    guard.set_gains(-55.0, 3.0, 0.002)
    assert (guard.command(0.002).delta_kp, guard.command(0.002).delta_ki) == (0.0, 3.0), "gains inside are left alone"
    assert list(guard.take_events()) == [MISMATCHED]


def test_gains_are_wide_again_only_once_a_correction_was_decided():
    guard = opened()
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 49, 0.001)
    for status in (CorrectionStatus.STALE, CorrectionStatus.NAN, CorrectionStatus.BYPASSED):
        guard.set_correction(0.0, status, 50, 0.002)
        assert guard.command(0.002).delta_kp == 75.0
    guard.set_correction(0.02, CorrectionStatus.PASS, 0, 0.003)
    assert guard.command(0.003).delta_kp == 75.0, "a decision about a sample of long ago is none"
    guard.note_sample(51)
    guard.set_correction(0.02, CorrectionStatus.MODIFIED, 51, 0.004)
    assert guard.command(0.004) == Command(delta_kp=235.0, delta_ki=50.0, delta_u=0.02, corrects=51, filter_fresh=True)


def test_an_outdated_mismatch_narrows_all_the_same_and_silence_after_it_gives_base_gains():
    guard = opened()
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 2, 0.001)
    assert (guard.command(0.001).delta_kp, guard.command(0.001).delta_u) == (75.0, 0.0)
    assert guard.command(0.1).delta_kp == 0.0
    unrequired = opened()
    unrequired.settings = GuardSettings(delta_kp_max=285.0, require_filter=False)
    unrequired.set_correction(0.0, CorrectionStatus.MISMATCH, 50, 0.001)
    assert unrequired.command(0.1).delta_kp == 75.0, "nor does a guard that needs no filter open up"


def test_a_correction_answers_one_sample_once_and_in_order():
    guard = CommandGuard()
    for sequence in (2**32 - 1, 0, 1):
        guard.note_sample(sequence)
    for sequence, delta_u in ((0, 0.01), (0, 0.02), (2**32 - 1, 0.02), (2, 0.02), (1, 0.015)):
        guard.set_correction(delta_u, CorrectionStatus.MODIFIED, sequence, 0.0)
    command = guard.command(0.0)
    assert (command.delta_u, command.corrects) == (0.015, 1)
    assert (guard.counts.repeated, guard.counts.outdated) == (2, 1), "two were answered before, one never was"
    guard.note_sample(None)
    guard.note_sample(1)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 1, 0.0)
    assert guard.command(0.0).delta_u == 0.01, "a box that starts again counts again"


def test_no_correction_asks_for_more_than_the_valves_current():
    guard = CommandGuard(valve_current_max=0.05)
    for sequence, nominal, asked, goes_down in (
        (1, 0.04, 0.015, 0.01),
        (2, 0.04, -0.015, -0.015),
        (3, -0.045, -0.01, -0.005),
        (4, 0.2, -0.02, -0.02),
        (5, 0.0, 0.1, LIMITS.delta_u_max),
    ):
        guard.note_sample(sequence, nominal)
        guard.set_correction(asked, CorrectionStatus.MODIFIED, sequence, 0.0)
        assert guard.command(0.0).delta_u == pytest.approx(goes_down)


OFFERED = BoxLaw()
SHAPED = LawCommand(
    law=Law.COMPENSATED, coefficients=(1.05, 0.03, 1e-4, -5.0), velocity_compensation=0.2, valve_gain_scale=1.5
)


def compensated(**settings: object) -> CommandGuard:
    guard = CommandGuard(settings=GuardSettings(**settings))  # type: ignore[arg-type]
    guard.set_box_law(OFFERED)
    guard.set_law(SHAPED, 0.0)
    guard.set_gains(-100.0, 5.0, 0.0)
    guard.set_arm(True)
    guard.set_gains(-100.0, 5.0, 0.0)
    guard.take_events()
    return guard


def shaping(command: Command) -> LawCommand:
    return LawCommand(**{name: getattr(command, name) for name in vars(SHAPED)})


def test_the_compensated_law_goes_through_with_its_own_gains_and_without_a_filter():
    command = compensated().command(0.1)
    assert shaping(command) == SHAPED
    assert (command.delta_kp, command.delta_ki, command.delta_u) == (-100.0, 5.0, 0.0) and command.filter_fresh


def test_a_correction_acts_under_the_compensated_law_as_long_as_under_the_papers_and_no_bypass_does():
    guard = compensated()
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 77, 0.0)
    assert [guard.command(age).delta_u for age in (0.001, 0.01)] == [0.01, 0.0]
    guard.set_correction(0.01, CorrectionStatus.BYPASSED, 78, 0.01)
    assert guard.command(0.011).delta_u == 0.0


@pytest.mark.parametrize("silent", ["gains", "law"])
def test_stale_gains_or_coefficients_give_the_safe_record_of_the_compensated_law(silent):
    guard = compensated()
    if silent == "gains":
        guard.set_law(SHAPED, 0.25)
    else:
        guard.set_gains(-100.0, 5.0, 0.25)
    for now in (0.25, 0.26):
        command = guard.command(now)
        assert shaping(command) == safe_command(OFFERED) and command.coefficients == NEUTRAL
        assert (command.delta_kp, command.delta_ki) == (0.0, 0.0) and command.arm
        assert command.filter_fresh == (silent == "gains")  # what is not commanded is shown by FILTER_STALE
    assert list(guard.take_events()) == [STALE_LAW] and guard.counts.stale_law == 2
    guard.set_law(SHAPED, 0.3)
    guard.set_gains(-100.0, 5.0, 0.3)
    assert shaping(guard.command(0.3)) == SHAPED


def test_mismatch_leaves_the_base_gains_of_the_compensated_law_and_its_coefficients():
    guard = compensated()
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 77, 0.0)
    command = guard.command(0.001)
    assert (command.delta_kp, command.delta_ki) == (0.0, 0.0) and shaping(command) == SHAPED


@given(st.lists(anything, min_size=6, max_size=6), anything, anything)
def test_whatever_law_command_comes_in_what_goes_down_is_finite_and_within_the_laws_limits(numbers, kp, ki):
    guard = compensated()
    wanted = LawCommand(
        law=Law.COMPENSATED, coefficients=tuple(numbers[:4]), velocity_compensation=numbers[4],
        valve_gain_scale=numbers[5],
    )  # fmt: skip
    guard.set_law(wanted, 0.1)
    guard.set_gains(kp, ki, 0.1)
    command = guard.command(0.1)
    if not all(map(isfinite, numbers)):
        assert shaping(command) == SHAPED  # dropped: the last one holds, and ages
        assert shaping(guard.command(0.25)) == safe_command(OFFERED)
    for a, low, high in zip(command.coefficients, OFFERED.coefficient_min, OFFERED.coefficient_max, strict=True):
        assert low <= a <= high
    for name in ("velocity_compensation", "valve_gain_scale", "delta_kp", "delta_ki"):
        assert getattr(OFFERED, f"{name}_min") <= getattr(command, name) <= getattr(OFFERED, f"{name}_max")


def test_a_coefficient_out_of_range_is_clamped_and_told_once():
    guard = compensated()
    for _ in range(3):
        guard.set_law(replace(SHAPED, coefficients=(2.0, 0.03, 1e-4, -5.0)), 0.1)
    assert guard.command(0.1).coefficients == (OFFERED.coefficient_max[0], 0.03, 1e-4, -5.0)
    assert list(guard.take_events()) == ["a_0 is outside [0.8, 1.25]: clamped"]


@pytest.mark.parametrize("first", list(Law))
def test_another_law_is_refused_while_armed_and_taken_once_disarmed(first):
    guard = CommandGuard()
    guard.set_box_law(OFFERED)
    commands = {Law.PAPER: LawCommand(), Law.COMPENSATED: SHAPED}
    other = Law(1 - first)
    guard.set_law(commands[first], 0.0)
    guard.set_arm(True)
    guard.set_law(commands[other], 0.01)
    assert guard.command(0.02).law is first and KEPT_WHILE_ARMED in guard.take_events()
    guard.set_arm(False)
    guard.set_gains(50.0, 5.0, 0.03)
    guard.set_law(commands[other], 0.03)
    command = guard.command(0.03)
    assert command.law is other and (command.delta_kp, command.delta_ki) == (0.0, 0.0)  # they were the other law's


def test_a_box_without_the_compensated_law_refuses_it():
    guard = CommandGuard()
    guard.set_law(SHAPED, 0.0)
    guard.set_law(SHAPED, 0.01)
    assert guard.command(0.01) == Command() and guard.counts.laws_refused == 2
    assert list(guard.take_events()) == [NOT_OFFERED]


def test_every_box_and_every_holder_begins_with_the_papers_law_and_the_safe_command():
    guard = CommandGuard()
    assert guard.command(0.0) == Command() and list(guard.take_events()) == []
    for forget in (
        lambda guard: guard.set_box_law(None), lambda guard: guard.set_box_law(OFFERED), CommandGuard.release_law
    ):  # fmt: skip
        guard = compensated()
        guard.set_arm(False)
        forget(guard)
        assert guard.command(0.01) == Command()
