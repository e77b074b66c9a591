# SPDX-License-Identifier: Apache-2.0
"""What goes down to a box, whatever the graph sends: finite, clamped, fresh, by a law that the box offers."""

from __future__ import annotations

from dataclasses import replace
from math import inf, isfinite, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.safety import guard as guards
from hydro_bridge.safety.guard import CommandGuard, GuardSettings, safe_command
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import (
    NEUTRAL_COEFFICIENTS,
    Command,
    CorrectionStatus,
    Law,
    LawCommand,
    ReferenceSignal,
    Waveform,
)

anything = st.floats(allow_nan=True, allow_infinity=True)
LIMITS = GuardSettings()
OFFERED = BoxLaw()
SHAPED = LawCommand(
    law=Law.COMPENSATED, coefficients=(1.05, 0.03, 1e-4, -5.0, 2e-6), velocity_compensation=0.2, valve_gain_scale=1.5
)
SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0)


def fresh() -> CommandGuard:
    """Under the paper's law, gains and a correction that have just come."""
    guard = CommandGuard()
    guard.set_gains(30.0, 4.0, 0.0)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 77, 0.0)
    return guard


def opened(**settings: object) -> CommandGuard:
    """Opened wide by name, wide gains in force, a correction of 10 mA for the newest sample, 50."""
    guard = CommandGuard(settings=GuardSettings(delta_kp_min=-55.0, delta_kp_max=285.0, delta_ki_max=95.0, **settings))
    guard.set_gains(235.0, 50.0, 0.0)
    guard.add_sample(50)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 50, 0.0)
    return guard


def compensated() -> CommandGuard:
    """Under the compensated law, armed, its gains just come."""
    guard = CommandGuard()
    guard.set_box_law(OFFERED)
    guard.set_law(SHAPED, 0.0)
    guard.set_arm(True)
    guard.set_gains(-100.0, 5.0, 0.0)
    guard.take_events()
    return guard


def gains(command: Command) -> tuple[float, float]:
    return command.delta_kp, command.delta_ki


def shaping(command: Command) -> LawCommand:
    return LawCommand(**{name: getattr(command, name) for name in vars(SHAPED)})


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


@given(st.fixed_dictionaries(dict.fromkeys(("amplitude", "offset", "frequency", "phase"), anything)))
def test_whatever_reference_comes_in_what_goes_down_is_fit(numbers):
    guard, signal = CommandGuard(), ReferenceSignal(waveform=Waveform.SINE, **numbers)
    taken = guard.set_reference(signal)
    down = guard.command(0.0).reference
    assert down == (signal if taken else ReferenceSignal())
    assert all(map(isfinite, (down.amplitude, down.offset, down.frequency, down.phase)))
    assert down.amplitude + abs(down.offset) <= LIMITS.reference_force_max
    assert guard.counts.references_refused == (not taken)


def test_a_reference_is_refused_as_a_box_would_and_a_hold_goes_down_with_a_frequency_that_every_box_takes():
    guard, changes = CommandGuard(), ({"frequency": 1e-60}, {"phase": 1e60}, {"phase": -1e39})  # unfit as float32
    assert not any(guard.set_reference(replace(SINE, **change)) for change in changes)
    assert guard.counts.references_refused == len(changes)
    for frequency in (0.0, -1.0, 1e6, 1e-60):
        assert guard.set_reference(ReferenceSignal(waveform=Waveform.HOLD, offset=100.0, frequency=frequency))
        assert guard.command(0.0).reference == ReferenceSignal(offset=100.0)


def test_stale_correction_gives_base_gains_no_correction_and_is_told_once():
    guard = fresh()
    assert guard.command(0.02).filter_fresh and not guard.command(0.0201).filter_fresh
    assert not guard.take_events(), "nothing is told of a plant that is not armed"
    guard.counts.stale_correction = 0
    guard.set_arm(True)
    for now in (0.0201, 0.03, 0.04):
        command = guard.command(now)
        assert gains(command) == (0.0, 0.0) and command.delta_u == 0.0 and not command.filter_fresh
    assert guard.counts.stale_correction == 3
    (said,) = guard.take_events()
    assert said.startswith("no correction for 20 ms: base gains, no correction")
    guard.set_correction(0.0, CorrectionStatus.PASS, 78, 0.05)
    assert guard.command(0.05).delta_kp == 30.0
    assert guard.take_events() == {"corrections are fresh again": False}, "the end of a trouble is none"


@pytest.mark.parametrize("make", [fresh, compensated])
def test_a_correction_acts_for_three_samples_while_the_gains_go_on_and_no_bypass_does(make):
    guard = make()
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 77, 0.0)
    chosen = gains(guard.command(0.0))
    commands = [guard.command(now) for now in (0.001, 0.003, 0.0031, 0.019)]
    assert [command.delta_u for command in commands] == [0.01, 0.01, 0.0, 0.0]
    assert all(gains(command) == chosen != (0.0, 0.0) and command.filter_fresh for command in commands)
    guard.set_correction(0.01, CorrectionStatus.BYPASSED, 78, 0.019)
    assert guard.command(0.0191).delta_u == 0.0 and not guard.take_events()


def test_a_correction_of_an_old_sample_neither_acts_nor_counts_as_fresh_however_lately_it_came():
    rows = (100, 100, True), (120, 100, True), (121, 100, False), (5, 6, False), (3, 2**32 - 3, True)  # the count wraps
    for newest, corrects, counts in rows:
        guard = CommandGuard()
        guard.add_sample(newest)
        guard.set_correction(0.01, CorrectionStatus.PASS, corrects, 1.0)
        assert guard.command(1.0).filter_fresh is counts and guard.counts.outdated == (not counts)
    guard = fresh()
    for newest, delta_u in ((79, 0.01), (80, 0.0)):
        guard.add_sample(newest)
        assert (guard.command(0.0).delta_u, guard.command(0.0).delta_kp) == (delta_u, 30.0)


def test_a_correction_answers_one_sample_once_and_in_order():
    guard = CommandGuard()
    for sequence in (2**32 - 1, 0, 1):
        guard.add_sample(sequence)
    for sequence, delta_u in ((0, 0.01), (0, 0.02), (2**32 - 1, 0.02), (2, 0.02), (1, 0.015)):
        guard.set_correction(delta_u, CorrectionStatus.MODIFIED, sequence, 0.0)
    command = guard.command(0.0)
    assert (command.delta_u, command.corrected_sequence) == (0.015, 1)
    assert (guard.counts.repeated, guard.counts.outdated) == (2, 1), "two were answered before, one never was"
    guard.add_sample(None)
    guard.add_sample(1)
    guard.set_correction(0.01, CorrectionStatus.MODIFIED, 1, 0.0)
    assert guard.command(0.0).delta_u == 0.01, "a box that starts again counts again"


def test_no_correction_asks_for_more_than_the_valves_current():
    guard = CommandGuard(valve_current_max=0.05)
    rows = (0.04, 0.015, 0.01), (0.04, -0.015, -0.015), (-0.045, -0.01, -0.005), (0.2, -0.02, -0.02), (0.0, 0.1, 0.02)
    for sequence, (nominal, asked, goes_down) in enumerate(rows):
        guard.add_sample(sequence, nominal)
        guard.set_correction(asked, CorrectionStatus.MODIFIED, sequence, 0.0)
        assert guard.command(0.0).delta_u == pytest.approx(goes_down)


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
    assert gains(guard.command(0.01)) == (75.0, 0.0) and guard.counts.clamped == 6
    assert list(guard.take_events()) == ["delta_kp is outside [0, 75]: clamped", "delta_ki is outside [0, 10]: clamped"]
    guard = compensated()
    for _ in range(3):
        guard.set_law(replace(SHAPED, coefficients=(2.0, 0.03, 1e-4, -5.0, 2e-6)), 0.1)
    assert guard.command(0.1).coefficients == (OFFERED.coefficient_max[0], 0.03, 1e-4, -5.0, 2e-6)
    assert list(guard.take_events()) == ["a_0 is outside [0.8, 1.25]: clamped"]


def test_without_the_filter_gains_pass_only_if_that_was_asked_for_and_the_flag_says_so():
    guard = CommandGuard(settings=GuardSettings(require_filter=False))
    guard.set_gains(30.0, 4.0, 0.0)
    command = guard.command(0.01)
    assert (command.delta_kp, command.delta_u) == (30.0, 0.0) and not command.filter_fresh


def test_stale_gains_give_base_gains_and_keep_the_correction_and_are_told_while_armed():
    for armed in (True, False):
        guard = CommandGuard()
        guard.set_arm(armed)
        guard.set_gains(30.0, 4.0, 0.0)
        guard.set_correction(0.01, CorrectionStatus.PASS, 300, 0.3)
        command = guard.command(0.3)
        assert gains(command) == (0.0, 0.0) and command.delta_u == 0.01 and guard.counts.stale_gains == 1
        assert list(guard.take_events()) == armed * ["no gains for 200 ms: base gains are in force"]


def test_gains_that_never_come_back_disarm_and_stop_the_reference_once_and_say_so():
    guard = fresh()
    guard.set_arm(True)
    guard.set_reference(SINE)
    assert guard.command(1000.0).arm, "none came since the arming: it is by hand"
    guard.set_gains(30.0, 4.0, 1000.0)
    assert (guard.command(1010.0).arm, guard.command(1010.0).reference) == (True, SINE)
    guard.take_events()
    for now in (1010.1, 1010.2):
        assert guard.command(now) == Command(corrected_sequence=77)
    sentence = "no gains for 10 s, whoever chose them is gone; reference 0 N, disarmed until it is armed again"
    assert list(guard.take_events()) == [sentence] and guard.abort_reason == sentence and guard.counts.given_up == 1
    guard.set_gains(30.0, 4.0, 1010.3)
    assert not guard.command(1010.3).arm, "gains alone arm nothing"
    guard.set_arm(True)
    assert guard.command(1100.0).arm and guard.abort_reason == "", "armed on purpose, and nobody has chosen gains since"
    guard = CommandGuard(settings=GuardSettings(gains_timeout=2.0))
    guard.set_arm(True)
    for now in (0.0, 2.0, 4.0):
        guard.set_gains(30.0, 4.0, now)
        assert guard.command(now + 1.9).arm
    guard.set_arm(False)
    guard.command(100.0)
    assert guard.abort_reason == "", "a plant that is disarmed has nothing to give up"


def test_a_filter_whose_model_is_not_this_benchs_leaves_narrow_gains_and_no_correction_until_it_decides():
    guard = opened()
    wide = Command(delta_kp=235.0, delta_ki=50.0, delta_u=0.01, corrected_sequence=50, filter_fresh=True)
    assert guard.command(0.0) == wide
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 50, 0.001)
    assert guard.command(0.001) == Command(delta_kp=75.0, delta_ki=10.0, corrected_sequence=50, filter_fresh=False)
    assert guard.counts.narrowed == guard.counts.mismatched == 1
    guard.set_gains(-55.0, 3.0, 0.002)
    assert gains(guard.command(0.002)) == (0.0, 3.0), "gains inside are left alone"
    assert list(guard.take_events()) == [
        "the filter says that its model is not this bench's: no correction, gains within the narrow range"
    ]
    guard.set_gains(235.0, 50.0, 0.002)
    for status in (CorrectionStatus.STALE, CorrectionStatus.NAN, CorrectionStatus.BYPASSED):
        guard.set_correction(0.0, status, 50, 0.002)
        assert guard.command(0.002).delta_kp == 75.0
    guard.set_correction(0.02, CorrectionStatus.PASS, 0, 0.003)
    assert guard.command(0.003).delta_kp == 75.0, "a decision about a sample of long ago is none"
    guard.add_sample(51)
    guard.set_correction(0.02, CorrectionStatus.MODIFIED, 51, 0.004)
    assert guard.command(0.004) == replace(wide, delta_u=0.02, corrected_sequence=51)


@pytest.mark.parametrize(("required", "later"), [(True, 0.0), (False, 75.0)])
def test_an_outdated_mismatch_narrows_all_the_same_and_silence_after_it_opens_nothing(required, later):
    guard = opened(require_filter=required)
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 2, 0.001)
    assert (guard.command(0.001).delta_kp, guard.command(0.001).delta_u) == (75.0, 0.0)
    assert guard.command(0.1).delta_kp == later


def test_the_compensated_law_needs_no_filter_and_a_mismatch_leaves_its_base_gains_and_its_coefficients():
    guard = compensated()
    command = guard.command(0.1)
    assert shaping(command) == SHAPED and gains(command) == (-100.0, 5.0)
    assert command.delta_u == 0.0 and command.filter_fresh
    guard.set_correction(0.0, CorrectionStatus.MISMATCH, 77, 0.1)
    assert shaping(guard.command(0.101)) == SHAPED and gains(guard.command(0.101)) == (0.0, 0.0)


@pytest.mark.parametrize("silent", ["gains", "law"])
def test_stale_gains_or_coefficients_give_the_safe_record_of_the_compensated_law(silent):
    guard = compensated()
    if silent == "gains":
        guard.set_law(SHAPED, 0.25)
    else:
        guard.set_gains(-100.0, 5.0, 0.25)
    for now in (0.25, 0.26):
        command = guard.command(now)
        assert shaping(command) == safe_command(OFFERED) and command.coefficients == NEUTRAL_COEFFICIENTS
        assert gains(command) == (0.0, 0.0) and command.arm
        assert command.filter_fresh == (silent == "gains")  # what is not commanded is shown by FILTER_STALE
    (event,) = guard.take_events()
    assert event.startswith("the compensated law is not commanded") and guard.counts.stale_law == 2
    guard.set_law(SHAPED, 0.3)
    guard.set_gains(-100.0, 5.0, 0.3)
    assert shaping(guard.command(0.3)) == SHAPED


@given(st.lists(anything, min_size=7, max_size=7), anything, anything)
def test_whatever_law_command_comes_in_what_goes_down_is_finite_and_within_the_laws_limits(numbers, kp, ki):
    guard, (*coefficients, c_1, c_2) = compensated(), numbers
    wanted = replace(SHAPED, coefficients=tuple(coefficients), velocity_compensation=c_1, valve_gain_scale=c_2)
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


@pytest.mark.parametrize("first", list(Law))
def test_another_law_is_refused_while_armed_and_taken_once_disarmed(first):
    guard = CommandGuard()
    guard.set_box_law(OFFERED)
    commands, other = {Law.PAPER: LawCommand(), Law.COMPENSATED: SHAPED}, Law(1 - first)
    guard.set_law(commands[first], 0.0)
    guard.set_arm(True)
    guard.set_law(commands[other], 0.01)
    assert (
        guard.command(0.02).law is first
        and "another force law is refused while the plant is armed: disarm it first" in guard.take_events()
    )
    guard.set_arm(False)
    guard.set_gains(50.0, 5.0, 0.03)
    guard.set_law(commands[other], 0.03)
    command = guard.command(0.03)
    assert command.law is other and gains(command) == (0.0, 0.0)  # they were the other law's


def test_a_box_without_the_compensated_law_refuses_it():
    guard = CommandGuard()
    guard.set_law(SHAPED, 0.0)
    guard.set_law(SHAPED, 0.01)
    assert guard.command(0.01) == Command() and guard.counts.laws_refused == 2
    assert list(guard.take_events()) == [guards.LAW_NOT_OFFERED_MESSAGE]


@pytest.mark.parametrize("law", [None, OFFERED, "the same, another holder"])
def test_every_box_and_every_holder_begins_with_the_papers_law_and_the_safe_command(law):
    guard = compensated()
    guard.set_arm(False)
    if isinstance(law, str):
        guard.release_law()
    else:
        guard.set_box_law(law)
    assert guard.command(0.01) == Command() == CommandGuard().command(0.0)
