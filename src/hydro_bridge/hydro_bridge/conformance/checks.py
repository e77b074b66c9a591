# SPDX-License-Identifier: Apache-2.0
"""Checks of a box by their names in `cases.yaml`, on the states received since the last step began.

Each gets its parameters from the case, and raises ViolationError with a sentence about what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import astuple
from itertools import pairwise
from math import copysign, isclose, isfinite

import numpy as np

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.reference import Derivatives, expected_references, nominal_current
from hydro_bridge.serial.protocol import BoxDetails, BoxLaw, State
from hydro_core.files import bench_digest
from hydro_core.signals import NEUTRAL_COEFFICIENTS, SAMPLE_PERIOD, STATE_FIELDS, Command, Flag, Law, flag_names

FLOAT32_TOLERANCE = 1e-6
"""Relative error of a float32, with room for one operation."""


class ViolationError(Exception):
    """The box does not keep the protocol."""


class InconclusiveError(Exception):
    """The observations are inconclusive: the case gets no verdict."""


class NotReportedError(Exception):
    """The box does not report a value that a check needs and that is optional: the case is skipped."""


def state_value(state: State, name: str) -> float:
    """Return a float field of a state by its name."""
    return state.values[STATE_FIELDS.index(name)]


def confirmed_states(host: Host) -> Sequence[State]:
    """Return the states of this step, starting with the one that confirms its first command."""
    sent = host.sent[host.step_first_command :]
    states = host.states[host.confirmation_index(sent[0].sequence) :] if sent else host.new_states
    if not states:
        raise ViolationError("no command was confirmed")
    return states


def equal_float32(one: float, other: float) -> bool:
    """Return whether two numbers agree as float32."""
    return isclose(one, other, rel_tol=FLOAT32_TOLERANCE, abs_tol=1e-12)


def expect_close(
    state: State, name: str, right: float, tolerance: float, unit: str = "", found: float | None = None, more: str = ""
) -> None:
    """Raise ViolationError unless a field of a state, or `found` in its place, is `right` to within `tolerance`."""
    found = state_value(state, name) if found is None else found
    if not abs(found - right) <= tolerance:  # nor is NaN
        raise ViolationError(f"{name} is {found:g}{unit} in STATE {state.sequence}, {right:g}{unit} is right{more}")


def check_flags(host: Host, has: Sequence[str] = (), lacks: Sequence[str] = ()) -> None:
    """Check that every confirmed state has the flags `has` and none of `lacks`."""
    wanted, unwanted = (sum(Flag[name] for name in names) for names in (has, lacks))
    for state in confirmed_states(host):
        if state.flags & wanted != wanted or state.flags & unwanted:
            raise ViolationError(f"STATE {state.sequence} has {flag_names(state.flags)}")


def check_field(host: Host, name: str, equals: Sequence[str | float], tolerance: float = 1e-3, last: int = 0) -> None:
    """Check that a field equals a sum of numbers and HELLO entries in all confirmed states, or the `last` ones."""
    right = sum(getattr(host.info, each) if isinstance(each, str) else float(each) for each in equals)
    for state in confirmed_states(host)[-last:]:
        expect_close(state, name, right, tolerance)


def check_command_accepted(host: Host) -> None:
    """Check that the last command sent was accepted."""
    sequence = host.sent[-1].sequence
    if not any(state.last_command == sequence for state in host.new_states):
        raise ViolationError(f"command {sequence} was not taken")


def check_unchanged(host: Host, name: str) -> None:
    """Check that a field keeps the value from before the step, in every state before the watchdog takes base gains.

    Raises InconclusiveError: there is none, since box or host was held up by its machine.
    """
    last = host.states[host.step_first_state - 1]
    before = state_value(last, name)
    compared = [state for state in host.new_states if not state.flags & ~last.flags & Flag.WATCHDOG]
    if not compared:
        raise InconclusiveError(f"{name} cannot be compared: the watchdog came before the first state of the step")
    if other := {state_value(state, name) for state in compared} - {before}:
        raise ViolationError(f"{name} was {before:g}, and became {max(other):g}")


def check_flag_delay(host: Host, flag: str, samples: tuple[int, int]) -> None:
    """Check that a flag first appears within a range of `samples` after the last accepted command."""
    states = host.states[host.confirmation_index(host.states[-1].last_command) :]
    found = next((n for n, state in enumerate(states) if state.flags & Flag[flag]), None)
    if found is None:
        raise ViolationError(f"{flag} did not come within {len(states)} samples")
    if not samples[0] <= found <= samples[1]:
        raise ViolationError(f"{flag} came {found} samples behind the last command")


def check_watchdog_response(host: Host) -> None:
    """Check that the box runs base gains, no correction and FILTER_STALE while WATCHDOG is set."""
    late = [state for state in host.new_states if state.flags & Flag.WATCHDOG]
    for state in late:
        gains = state_value(state, "proportional_gain"), state_value(state, "integral_gain")
        base = (host.info.base_kp, host.info.base_ki)
        if not all(map(equal_float32, gains, base)) or not state.flags & Flag.FILTER_STALE:
            raise ViolationError(f"gains {gains[0]:g} and {gains[1]:g}, {flag_names(state.flags)}")
        corrected = state_value(state, "valve_current") != state_value(state, "nominal_valve_current")
        if corrected and not state.flags & Flag.SATURATED:
            raise ViolationError("the correction is still added")
    if not late:
        raise ViolationError("WATCHDOG did not come")


def check_refusal_counts(host: Host, values: int, references: int) -> None:
    """Check how many values and references the box refused in this step, by its own counters."""
    before, after = host.states[host.step_first_state - 1], host.states[-1]
    found = after.refused - before.refused, after.refused_references - before.refused_references
    if found != (values, references):
        raise ViolationError(f"it counted {found[0]} values and {found[1]} references")


def check_disarmed_state(host: Host, last: int = 0) -> None:
    """Check the state of a disarmed box: no current, and the reference equal to the feedback force."""
    for state in confirmed_states(host)[-last:]:
        if any(state_value(state, name) != 0.0 for name in ("valve_current", "nominal_valve_current")):
            raise ViolationError("a current is not 0")
        follows = state_value(state, "reference_force") == state_value(state, host.feedback)
        if not follows or state_value(state, "reference_force_rate") != 0.0:
            raise ViolationError(f"reference_force is not {host.feedback}, or its rate is not 0")
        if state.flags & Flag.ARMED:
            raise ViolationError("it is armed")


def check_stream_integrity(host: Host) -> None:
    """Check that no sample is missing or repeated, and that every frame is complete."""
    steps = {(b.sequence - a.sequence) % 2**32 for a, b in pairwise(host.new_states)}
    counts = host.decoder.counts
    if steps != {1}:
        raise ViolationError(f"sequence steps of {sorted(steps)}")
    if counts.malformed:
        raise ViolationError(f"{counts.crc_errors} check sums, {counts.malformed} frames are wrong")


def check_clock(host: Host, jitter: float = 200.0, share: float = 0.01) -> None:
    """Check the box's clock: each step within `jitter` [us] of a period, and its rate within `share` of the host's.

    An emulator has no rate of its own: it is as slow as the machine on which it runs.
    """
    times, arrived = [state.time_us for state in host.new_states], host.arrival_times[host.step_first_state :]
    steps = [b - a for a, b in pairwise(times)]
    if max(abs(step - 1e6 * SAMPLE_PERIOD) for step in steps) > jitter:
        raise ViolationError(f"steps of {min(steps)} to {max(steps)} us")
    if host.emulated:
        host.notes.append("an emulator's clock is not compared with the host's")
        return
    pace = (times[-1] - times[0]) * 1e-6 / (arrived[-1] - arrived[0])
    if not abs(pace - 1.0) <= share:
        raise ViolationError(f"{pace:.4f} s of the box are 1 s of the host")


def check_hello(host: Host) -> None:
    """Check that HELLO is complete: a name, ordered limits that include zero, 1 ms, a form of the integral."""
    info = host.info
    if not info.name:
        raise ViolationError("it has no name")
    if not info.integral:
        raise ViolationError("it does not tell the form of its integral")
    if not equal_float32(info.sample_period, SAMPLE_PERIOD):
        raise ViolationError(f"its sample period is {info.sample_period:g} s")
    if not (info.delta_kp_min <= 0.0 <= info.delta_kp_max and info.delta_ki_min <= 0.0 <= info.delta_ki_max):
        raise ViolationError("its limits of the gains do not hold 0")
    if not info.valve_current_max > 0.0 <= info.delta_u_max:
        raise ViolationError("its limits of the current are not positive")


def check_hello_reply(host: Host, within: int) -> None:
    """Check that HELLO was answered within `within` samples plus the line's lag, by a sequence number of 1 or more."""
    answers = [(n - host.hello_index, hello) for n, hello in host.hellos if n >= host.hello_index]
    if not answers or answers[0][0] > within + host.lag:
        raise ViolationError(f"no HELLO came within {within + host.lag} samples")
    if answers[0][1].sequence == 0:
        raise ViolationError("the answer has sequence 0, which says power-on")


def check_details(host: Host) -> None:
    """Check that DETAILS are complete: an epoch, times and ranges in order."""
    told = host.details
    if told == BoxDetails():
        raise ViolationError("none came")
    if not told.epoch:
        raise ViolationError("its epoch is 0")
    if not 0.0 < told.hold_timeout <= told.trip_timeout:
        raise ViolationError(f"its time-outs are {told.hold_timeout:g} and {told.trip_timeout:g} s")
    if bool(told.laws >> Law.COMPENSATED & 1) != (host.law is not None):
        raise ViolationError("LAW comes where DETAILS offer the compensated law, and only there")
    ordered = told.pressure_min < told.pressure_max and told.position_min < told.position_max
    if not (ordered and told.load_force_limit > 0.0 < told.force_range):
        raise ViolationError("a limit is 0, or a range is empty")


def check_bench_digest(host: Host) -> None:
    """Check that current limit and bench digest in HELLO and DETAILS agree with the bench file."""
    limit, told = host.bench["valve_current_max"], host.details.bench_digest
    if not equal_float32(host.info.valve_current_max, limit):
        raise ViolationError(f"valve_current_max {host.info.valve_current_max:g} A, the file has {limit:g} A")
    if not told:
        host.notes.append("its digest is not told: only valve_current_max is compared")
    elif told != (digest := bench_digest.digest(host.bench)):
        raise ViolationError(f"its bench is {told}, the file is {digest}")


_REFERENCE_FIELDS = ("reference_force", "reference_force_rate")
_CORRECTION_HOLD_TIME = 3500
"""us, duration for which the correction of a command acts."""


def check_valve_current(host: Host) -> None:
    """Check valve_current = clamp(nominal + delta_u), delta_u for 3.5 ms from acceptance; SATURATED if clamped."""
    limit, commands = host.info.valve_current_max, {each.sequence: each.command for each in host.sent}
    newest, since = None, 0
    for n, state in enumerate(host.states):
        if state.last_command != newest:
            newest, since = state.last_command, state.time_us
        command = commands.get(state.last_command)
        if n < host.step_first_state or not state.flags & Flag.ARMED or command is None:
            continue
        delta = command.delta_u if state.time_us - since <= _CORRECTION_HOLD_TIME else 0.0
        wanted = state_value(state, "nominal_valve_current") + delta
        clamped = min(max(wanted, -limit), limit)
        expect_close(state, "valve_current", clamped, 1e-7 + FLOAT32_TOLERANCE * abs(clamped), " A")
        if abs(abs(wanted) - limit) > 1e-6 and bool(state.flags & Flag.SATURATED) != (abs(wanted) > limit):
            flags = flag_names(state.flags)
            raise ViolationError(f"{wanted:g} A of {limit:g} A and {flags} in STATE {state.sequence}")


def check_force_law(host: Host, tolerance: float = 2e-7, share: float = 1e-4) -> None:
    """Check u_nom since arming against the force law for the box's measurements and its form of the integral.

    The integral is frozen (anti-windup) while the current is at its limit and K_i e has the current's sign. Whether
    the current includes the correction is checked by `check_valve_current`.
    """
    integral, armed, paper = 0.0, False, host.info.integral == "paper"
    full = (1.0 - FLOAT32_TOLERANCE) * host.info.valve_current_max
    for state in host.states:
        if not state.flags & Flag.ARMED:
            integral, armed = 0.0, False
            continue
        armed, acting = True, state.law_state
        names = dict(zip(STATE_FIELDS, state.values, strict=True)) | dict(
            zip(_REFERENCE_FIELDS, acting[1:3], strict=True)
        )
        action = names["integral_gain"] * integral if paper else integral
        scales = acting.velocity_compensation, acting.valve_gain_scale
        right = nominal_current(host.bench, names, action, host.feedback, scales)
        expect_close(state, "nominal_valve_current", right, tolerance + share * abs(right), " A")
        error = names["reference_force"] - names[host.feedback]
        slope, current = names["integral_gain"] * error, names["valve_current"]
        if not (abs(current) >= full and current * slope > 0.0):
            integral += SAMPLE_PERIOD * (error if paper else slope)
    if not armed:
        raise ViolationError("it was not armed")


def _judge_armed(host: Host, judge: Callable[[Sequence[Derivatives | None]], None]) -> None:
    """Apply `judge` to the expected references; the box passes if it does with either rounding of a fade's end."""
    wrong: list[ViolationError] = []
    for points in expected_references(host):
        if not any(points):
            raise ViolationError("it was not armed")
        try:
            judge(points)
        except ViolationError as violation:
            wrong.append(violation)
        else:
            return
    raise wrong[0]


def check_reference(host: Host, tolerance: float = 0.01, rate_tolerance: float = 0.5) -> None:
    """Check f_r and f_r' against the definition of the accepted references, cross-fades included."""
    allowed = host.force_scale * tolerance, host.force_scale * rate_tolerance

    def judge(points: Sequence[Derivatives | None]) -> None:
        for state, point in zip(host.states, points, strict=True):
            for name, right, off in zip(_REFERENCE_FIELDS, point or (), allowed, strict=False):
                expect_close(state, name, right, off + 1e-4 * abs(right))

    _judge_armed(host, judge)


_OVERLAP_SHARE_MAX = 0.05
"""Share of the largest current within which a valve may have overlap."""


def check_force_direction(host: Host, by: float) -> None:
    """Check that the feedback force moved towards the reference by at least `by` [N, scaled to the box].

    Raises InconclusiveError: the current stayed small and the force constant, as with a valve's overlap.
    """
    states, by = confirmed_states(host), host.force_scale * by
    begin, last = state_value(states[0], host.feedback), states[-1]
    moved, asked = state_value(last, host.feedback) - begin, state_value(last, "reference_force") - begin
    if moved * asked > 0.0 and abs(moved) >= by:
        return
    largest = max(abs(state_value(state, "valve_current")) for state in states)
    drives = state_value(last, "valve_current") * asked > 0.0
    if drives and abs(moved) < by and largest < _OVERLAP_SHARE_MAX * host.info.valve_current_max:
        why = "an overlap holds the piston there, or the valve is not connected: its sign is not proven"
        raise InconclusiveError(f"the force stood while the current stayed within {1e3 * largest:.2g} mA: {why}")
    raise ViolationError(f"asked for {asked:g} N, the force went by {moved:g} N")


def check_rates(host: Host) -> None:
    """Check that rates are differences through a first-order low-pass with the lags given in DETAILS."""
    told = host.details
    pairs = (("hydraulic_force", "hydraulic_force_rate", told.force_rate_age, 0.5),
             ("load_force", "load_force_rate", told.force_rate_age, 0.5),
             ("piston_position", "piston_velocity", told.velocity_age, 3e-5))  # fmt: skip
    if not any(age for _, _, age, _ in pairs):
        raise NotReportedError("DETAILS do not tell the ages of the rates")
    for reading, rate, age, tolerance in pairs:
        if age == 0.0:
            host.notes.append(f"the age of {rate} is not told")
            continue
        memory = (age / SAMPLE_PERIOD - 0.5) / (age / SAMPLE_PERIOD + 0.5)
        for a, b in pairwise(host.new_states):
            slope = (state_value(b, reading) - state_value(a, reading)) / SAMPLE_PERIOD
            right = memory * state_value(a, rate) + (1.0 - memory) * slope
            expect_close(b, rate, right, tolerance + 1e-3 * abs(right), more=f" for an age of {1e3 * age:g} ms")


def check_units(host: Host, share: float = 0.05) -> None:
    """Check that readings are in Pa, m and N: within the bench's ranges, and f_h equal to the force of the pressures.

    `share`: tolerance of f_h, relative to piston area times supply pressure.
    """
    supply, stroke, area = (host.bench[name] for name in ("supply_pressure", "stroke", "piston_area"))
    for state in host.new_states:
        a, b, position = (state_value(state, name) for name in ("pressure_a", "pressure_b", "piston_position"))
        if not all(-0.1 * supply <= pressure <= 1.5 * supply for pressure in (a, b)):
            raise ViolationError(f"pressures of {a:g} and {b:g} Pa")
        if not -0.1 * stroke <= position <= 1.1 * stroke:
            raise ViolationError(f"a position of {position:g} m")
        right, force = area * (a - host.bench["area_ratio"] * b), state_value(state, "hydraulic_force")
        if not abs(force - right) <= share * area * supply:
            raise ViolationError(f"hydraulic_force is {force:g} N, the pressures give {right:g} N")
        if not all(map(isfinite, state.values)):
            raise ViolationError("a value is not finite")


def check_law_limits(host: Host) -> None:
    """Check that the safe state in the LAW frame is within its limits, and acts while the box is disarmed."""
    law = host.law
    assert law is not None, "its case needs a compensated law"
    if not np.isfinite(np.hstack(astuple(law))).all():
        raise ViolationError("a number of it is not finite")
    for low, safe, high, rate in zip(*law.shaping_limits, strict=True):
        if not (low <= safe <= high and rate > 0.0):
            limits = f"the limits are {low:g} and {high:g}, the fastest change is {rate:g} a second"
            raise ViolationError(f"{safe:g} is safe, {limits}")
    if not (law.delta_kp_min <= 0.0 <= law.delta_kp_max and law.delta_ki_min <= 0.0 <= law.delta_ki_max):
        raise ViolationError("its limits of the gains do not hold 0")
    for state in confirmed_states(host):
        acting, force = state.law_state, state_value(state, host.feedback)
        if acting.law is not Law.COMPENSATED or not all(map(equal_float32, acting.coefficients, NEUTRAL_COEFFICIENTS)):
            raise ViolationError(f"law {acting.law.name} with {acting.coefficients} acts in STATE {state.sequence}")
        if acting.compensated_reference != force or acting.compensated_reference_rate != 0.0:
            raise ViolationError(f"f_c is {acting.compensated_reference:g} N while it is disarmed")


_SHAPING_TOLERANCE = 2e-6
"""Rounding of float32 in a value of the shaping, relative to its limits."""
_LOW_PASS_TIME = 4e-3
"""Time constant [s] of the low-pass of f_r'' in f_c."""


def _demand(law: BoxLaw, command: Command | None, *, late: bool) -> tuple[list[float], tuple[float, float]]:
    """Return shaping and gains that a box must apply for a command; non-finite numbers count as the safe ones."""
    low, safe, high, _ = law.shaping_limits
    if late or command is None or command.law is not Law.COMPENSATED:
        return safe, (law.base_kp, law.base_ki)
    wanted = (command.delta_kp, command.delta_ki, *command.shaping)
    least, most = (law.delta_kp_min, law.delta_ki_min, *low), (law.delta_kp_max, law.delta_ki_max, *high)
    kp, ki, *shaping = (
        min(max(number, low), high) if isfinite(number) else safe
        for number, safe, low, high in zip(wanted, (0.0, 0.0, *safe), least, most, strict=True)
    )
    return shaping, (law.base_kp + kp, law.base_ki + ki)


def check_compensated_reference(host: Host, tolerance: float = 0.02) -> None:
    """Check gains, shaping and f_c of each armed sample against the one before and the command in force.

    `tolerance`: of f_c [N], scaled to the box; that of f_c' [N/s] is 50 times as large.

    The shaping (a_0 to a_3, C_1, C_2) follows the commanded one within the limits and rate limits in LAW; the safe one
    if the command is late or for the paper's law. f_r and f_r' are those of STATE, f_r'' and f_r''' of the command.
    """
    law, commands = host.law, {each.sequence: each.command for each in host.sent}
    assert law is not None, "its case needs a compensated law"
    low, safe, high, rate = law.shaping_limits
    room = [_SHAPING_TOLERANCE * max(abs(least), abs(most)) for least, most in zip(low, high, strict=True)]
    tolerance *= host.force_scale

    def judge(points: Sequence[Derivatives | None]) -> None:
        old, second, third = safe, 0.0, 0.0
        for state, point in zip(host.states, points, strict=True):
            if point is None:
                old, second, third = safe, 0.0, 0.0
                continue
            acting, late = state.law_state, bool(state.flags & Flag.WATCHDOG)
            wanted, gains = _demand(law, commands.get(state.last_command), late=late)
            shown = state_value(state, "proportional_gain"), state_value(state, "integral_gain")
            if not all(map(equal_float32, shown, gains)):
                raise ViolationError(f"the gains are {shown} in STATE {state.sequence}, {gains} is right")
            now = [*acting.coefficients, acting.velocity_compensation, acting.valve_gain_scale]
            for number, last, new, least, most, fastest, off in zip(
                now, old, wanted, low, high, rate, room, strict=True
            ):
                right = last + min(max(new - last, -fastest * SAMPLE_PERIOD), fastest * SAMPLE_PERIOD)
                if not abs(number - right) <= off or not least - off <= number <= most + off:
                    told = f"{right:g} is right: {last:g} before, {new:g} wanted"
                    raise ViolationError(f"{number:g} acts in STATE {state.sequence}, {told}")
            middle = second + 0.5 * SAMPLE_PERIOD * (point[3] + third)
            second = middle + (point[2] - middle) * SAMPLE_PERIOD / (SAMPLE_PERIOD + _LOW_PASS_TIME)
            third = point[3]
            force, force_rate = (state_value(state, name) for name in _REFERENCE_FIELDS)
            terms = (force, force_rate, second, 1.0)
            slopes = (force_rate, point[2], third + (point[2] - second) / _LOW_PASS_TIME, 0.0)
            right = sum(a * term for a, term in zip(now[:4], terms, strict=True))
            moved = (
                sum((a - last) * term for a, last, term in zip(now[:4], old[:4], terms, strict=True)) / SAMPLE_PERIOD
            )
            right_rate = moved + sum(a * slope for a, slope in zip(now[:4], slopes, strict=True))
            if abs(right) > law.reference_max:
                right, right_rate = copysign(law.reference_max, right), 0.0
            expect_close(state, "f_c", right, tolerance, " N", acting.compensated_reference)
            expect_close(state, "f_c'", right_rate, 50.0 * tolerance, " N/s", acting.compensated_reference_rate)
            old = now

    _judge_armed(host, judge)


CHECKS: dict[str, Callable[..., None]] = {
    "flags": check_flags,
    "field": check_field,
    "taken": check_command_accepted,
    "unchanged": check_unchanged,
    "first_flag": check_flag_delay,
    "late": check_watchdog_response,
    "refused": check_refusal_counts,
    "idle": check_disarmed_state,
    "undisturbed": check_stream_integrity,
    "clock": check_clock,
    "hello": check_hello,
    "greeted": check_hello_reply,
    "details": check_details,
    "believes": check_bench_digest,
    "current": check_valve_current,
    "law": check_force_law,
    "reference": check_reference,
    "follows": check_force_direction,
    "rates": check_rates,
    "units": check_units,
    "law_told": check_law_limits,
    "compensation": check_compensated_reference,
}
"""Checks by their names in `cases.yaml`."""
