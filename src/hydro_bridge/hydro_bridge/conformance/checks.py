# SPDX-License-Identifier: Apache-2.0
"""Checks of a box by their names in `cases.yaml`, on the states received since the last step began.

Each gets its parameters from the case, and returns a sentence about what is wrong, or an empty string.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import fields
from itertools import pairwise
from math import copysign, isclose, isfinite
from typing import Any

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.reference import Derivatives, expected_references, nominal_current
from hydro_bridge.serial.protocol import BoxInfo, BoxLaw, LawState, State
from hydro_core.files import bench_file
from hydro_core.signals import NEUTRAL, SAMPLE_PERIOD, STATE_FIELDS, Command, Flag, Law, flag_names

Bench = Mapping[str, Any] | None
"""Numbers of the bench file, if one was given."""


class InconclusiveError(Exception):
    """The observations are inconclusive: the case gets no verdict."""


class NotReportedError(Exception):
    """The box does not report a value that a check needs and that is optional: the case is skipped."""


FLOAT32_TOLERANCE = 1e-6
"""Relative error of a float32, with room for one operation."""


def state_value(state: State, name: str) -> float:
    """Return a float field of a state by its name."""
    return state.values[STATE_FIELDS.index(name)]


def box_info(host: Host) -> BoxInfo:
    """Return the content of the box's HELLO."""
    assert host.hello is not None and host.hello.info is not None
    return host.hello.info


def feedback_field(host: Host) -> str:
    """Return the name of the force field that the box feeds back: as given in DETAILS, else `load_force`."""
    told = host.details.details.feedback if host.details else ""
    return f"{told or 'load'}_force"


def confirmed_states(host: Host) -> Sequence[State]:
    """Return the states of this step, starting with the one that confirms its first command."""
    sent = host.sent[host.marked_sent :]
    return host.states[host.confirmation_index(sent[0].sequence) :] if sent else host.new_states


def equal_float32(one: float, other: float) -> bool:
    """Return whether two numbers agree as float32."""
    return isclose(one, other, rel_tol=FLOAT32_TOLERANCE, abs_tol=1e-12)


def check_flags(host: Host, bench: Bench, has: Sequence[str] = (), lacks: Sequence[str] = ()) -> str:
    """Check that every confirmed state has the flags `has` and none of `lacks`."""
    wanted, unwanted = (sum(Flag[name] for name in names) for names in (has, lacks))
    for state in confirmed_states(host):
        if state.flags & wanted != wanted or state.flags & unwanted:
            return f"STATE {state.sequence} has {flag_names(state.flags)}"
    return "" if confirmed_states(host) else "no command was confirmed"


def check_field(
    host: Host, bench: Bench, name: str, equals: Sequence[str | float], tolerance: float = 1e-3, last: int = 0
) -> str:
    """Check that a field equals a sum of numbers and HELLO entries in all confirmed states, or the `last` ones."""
    wanted = sum(getattr(box_info(host), each) if isinstance(each, str) else float(each) for each in equals)
    states = confirmed_states(host)[-last:]
    for state in states:
        if not abs(state_value(state, name) - wanted) <= tolerance:
            return f"{name} is {state_value(state, name):g} in STATE {state.sequence}, {wanted:g} is right"
    return "" if states else "no command was confirmed"


def check_command_accepted(host: Host, bench: Bench, yes: bool = True) -> str:
    """Check that the last command sent was accepted, or rejected where `yes` is false."""
    sequence = host.sent[-1].sequence
    found = any(state.last_command == sequence for state in host.new_states)
    return "" if found == yes else f"command {sequence} was {'not ' if yes else ''}taken"


def check_unchanged(host: Host, bench: Bench, name: str) -> str:
    """Check that a field keeps the value from before the step in every state."""
    before = state_value(host.states[host.marked - 1], name)
    now = {state_value(state, name) for state in host.new_states}
    return "" if now <= {before} else f"{name} was {before:g}, and became {max(now):g}"


def check_flag_delay(host: Host, bench: Bench, flag: str, samples: tuple[int, int]) -> str:
    """Check that a flag first appears within a range of `samples` after the last accepted command."""
    begin = host.confirmation_index(host.states[-1].last_command)
    states = host.states[begin:]
    found = next((n for n, state in enumerate(states) if state.flags & Flag[flag]), None)
    if found is None:
        return f"{flag} did not come within {len(states)} samples"
    return "" if samples[0] <= found <= samples[1] else f"{flag} came {found} samples behind the last command"


def check_watchdog_response(host: Host, bench: Bench) -> str:
    """Check that the box runs base gains, no correction and FILTER_STALE while WATCHDOG is set."""
    info = box_info(host)
    for state in host.new_states:
        if not state.flags & Flag.WATCHDOG:
            continue
        gains = state_value(state, "proportional_gain"), state_value(state, "integral_gain")
        if not all(map(equal_float32, gains, (info.base_kp, info.base_ki))) or not state.flags & Flag.FILTER_STALE:
            return f"gains {gains[0]:g} and {gains[1]:g}, {flag_names(state.flags)}"
        if (
            state_value(state, "valve_current") != state_value(state, "nominal_valve_current")
            and not state.flags & Flag.SATURATED
        ):
            return "the correction is still added"
    return "" if any(state.flags & Flag.WATCHDOG for state in host.new_states) else "WATCHDOG did not come"


def check_refusal_counts(host: Host, bench: Bench, values: int, references: int) -> str:
    """Check how many values and references the box refused in this step, by its own counters."""
    before, after = host.states[host.marked - 1], host.states[-1]
    found = [
        after.refused - before.refused, after.refused_references - before.refused_references
    ]  # fmt: skip
    return "" if found == [values, references] else f"it counted {found[0]} values and {found[1]} references"


def check_disarmed_state(host: Host, bench: Bench, last: int = 0) -> str:
    """Check the state of a disarmed box: no current, and the reference equal to the followed force."""
    force = feedback_field(host)
    for state in confirmed_states(host)[-last:]:
        if any(state_value(state, name) != 0.0 for name in ("valve_current", "nominal_valve_current")):
            return "a current is not 0"
        if (
            state_value(state, "reference_force") != state_value(state, force)
            or state_value(state, "reference_force_rate") != 0.0
        ):
            return f"reference_force is not {force}, or its rate is not 0"
        if state.flags & Flag.ARMED:
            return "it is armed"
    return "" if confirmed_states(host) else "no command was confirmed"


def check_stream_integrity(host: Host, bench: Bench) -> str:
    """Check that no sample is missing or repeated, and that every frame is complete."""
    steps = {(b.sequence - a.sequence) % 2**32 for a, b in pairwise(host.new_states)}
    counts = host.decoder.counts
    if steps != {1}:
        return f"sequence steps of {sorted(steps)}"
    return f"{counts.crc_errors} check sums, {counts.malformed} frames are wrong" if counts.malformed else ""


def check_clock(host: Host, bench: Bench, jitter: float = 200.0, share: float = 0.01) -> str:
    """Check the box's clock: each step within `jitter` [us] of a period, and its rate within `share` of the host's."""
    times = [state.time_us for state in host.new_states]
    steps = [b - a for a, b in pairwise(times)]
    if max(abs(step - 1e6 * SAMPLE_PERIOD) for step in steps) > jitter:
        return f"steps of {min(steps)} to {max(steps)} us"
    arrived = host.arrived[host.marked :]
    pace = (times[-1] - times[0]) * 1e-6 / (arrived[-1] - arrived[0])
    return "" if abs(pace - 1.0) <= share else f"{pace:.4f} s of the box are 1 s of the host"


def check_hello(host: Host, bench: Bench) -> str:
    """Check that HELLO is complete: a name, ordered limits that include zero, 1 ms, a form of the integral."""
    info = box_info(host)
    if not info.name:
        return "it has no name"
    if not info.integral:
        return "it does not tell the form of its integral"
    if not equal_float32(info.sample_period, SAMPLE_PERIOD):
        return f"its sample period is {info.sample_period:g} s"
    if not (info.delta_kp_min <= 0.0 <= info.delta_kp_max and info.delta_ki_min <= 0.0 <= info.delta_ki_max):
        return "its limits of the gains do not hold 0"
    return "" if info.valve_current_max > 0.0 <= info.delta_u_max else "its limits of the current are not positive"


def check_hello_reply(host: Host, bench: Bench, within: int) -> str:
    """Check that HELLO was answered within `within` samples plus the line's lag, by a sequence number of 1 or more."""
    answers = [(n - host.greeted_at, each) for n, each in host.hellos if n >= host.greeted_at]
    if not answers or answers[0][0] > within + host.lag:
        return f"no HELLO came within {within + host.lag} samples"
    if answers[0][1].sequence == 0:
        return "the answer has sequence 0, which says power-on"
    return ""


def check_details(host: Host, bench: Bench) -> str:
    """Check that DETAILS are complete: an epoch, times and ranges in order."""
    if host.details is None:
        return "none came"
    told = host.details.details
    if not told.epoch:
        return "its epoch is 0"
    if not 0.0 < told.hold_timeout <= told.trip_timeout:
        return f"its time-outs are {told.hold_timeout:g} and {told.trip_timeout:g} s"
    if bool(told.laws >> Law.COMPENSATED & 1) != (host.law is not None):
        return "LAW comes where DETAILS offer the compensated law, and only there"
    ordered = told.pressure_min < told.pressure_max and told.position_min < told.position_max
    return "" if ordered and told.load_force_limit > 0.0 < told.force_range else "a limit is 0, or a range is empty"


def check_bench_digest(host: Host, bench: Bench) -> str:
    """Check that current limit and bench digest in HELLO and DETAILS agree with the bench file."""
    assert bench is not None
    if not equal_float32(box_info(host).valve_current_max, bench["valve_current_max"]):
        return (
            f"valve_current_max {box_info(host).valve_current_max:g} A, the file has {bench['valve_current_max']:g} A"
        )
    told = host.details.details.bench_digest if host.details else ""
    if not told:
        host.notes.append("its digest is not told: only valve_current_max is compared")
    elif told != bench_file.digest(bench):
        return f"its bench is {told}, the file is {bench_file.digest(bench)}"
    return ""


_REFERENCE = ("reference_force", "reference_force_rate")
_CORRECTION_HOLD = 3500
"""us, duration for which the correction of a command acts."""


def check_valve_current(host: Host, bench: Bench) -> str:
    """Check valve_current = clamp(nominal + delta_u), delta_u for 3.5 ms from acceptance; SATURATED if clamped."""
    limit, commands = box_info(host).valve_current_max, {each.sequence: each.command for each in host.sent}
    newest, since = None, 0
    for n, state in enumerate(host.states):
        if state.last_command != newest:
            newest, since = state.last_command, state.time_us
        command = commands.get(state.last_command)
        if n < host.marked or not state.flags & Flag.ARMED or command is None:
            continue
        delta = command.delta_u if state.time_us - since <= _CORRECTION_HOLD else 0.0
        wanted = state_value(state, "nominal_valve_current") + delta
        clamped = min(max(wanted, -limit), limit)
        if not abs(state_value(state, "valve_current") - clamped) <= 1e-7 + FLOAT32_TOLERANCE * abs(clamped):
            found = f"valve_current is {state_value(state, 'valve_current'):g} A in STATE {state.sequence}"
            return f"{found}, {clamped:g} A is right"
        if abs(abs(wanted) - limit) > 1e-6 and bool(state.flags & Flag.SATURATED) != (abs(wanted) > limit):
            return f"{wanted:g} A of {limit:g} A and {flag_names(state.flags)} in STATE {state.sequence}"
    return ""


def check_force_law(host: Host, bench: Bench, tolerance: float = 2e-7, share: float = 1e-4) -> str:
    """Check u_nom since arming against the force law for the box's measurements and its form of the integral.

    The integral stands still while the current is at its limit and K_i e has the current's sign. Whether the current
    includes the correction is checked by `check_valve_current`.
    """
    assert bench is not None
    integral, armed, form, force = 0.0, False, box_info(host).integral, feedback_field(host)
    full = (1.0 - FLOAT32_TOLERANCE) * box_info(host).valve_current_max
    for state in host.states:
        names = dict(zip(STATE_FIELDS, state.values, strict=True))
        if not state.flags & Flag.ARMED:
            integral, armed = 0.0, False
            continue
        armed, scales = True, (1.0, 1.0)
        if acting := state.law_state:
            scales = acting.velocity_compensation, acting.valve_gain_scale
            names |= zip(_REFERENCE, acting[1:3], strict=True)
        action = integral if form != "paper" else names["integral_gain"] * integral
        wanted = nominal_current(bench, names, action, force, scales)
        if not abs(names["nominal_valve_current"] - wanted) <= tolerance + share * abs(wanted):
            found = f"nominal_valve_current is {names['nominal_valve_current']:g} A in STATE {state.sequence}"
            return f"{found}, {wanted:g} A is right"
        error = names["reference_force"] - names[force]
        slope, current = names["integral_gain"] * error, names["valve_current"]
        if not (abs(current) >= full and current * slope > 0.0):
            integral += SAMPLE_PERIOD * (slope if form != "paper" else error)
    return "" if armed else "it was not armed"


def check_reference(host: Host, bench: Bench, tolerance: float = 0.01, rate_tolerance: float = 0.5) -> str:
    """Check f_r and f_r' against the definition of the accepted references, cross-fades included."""
    allowed = host.force_scale * tolerance, host.force_scale * rate_tolerance
    return _either(_played(host, points, allowed) for points in expected_references(host, feedback_field(host)))


def _either(found: Iterable[str]) -> str:
    """Return what is wrong with either rounding of a fade's end; empty if it is right with one of them."""
    sentences = list(found)
    return "" if "" in sentences else sentences[0]


def _played(host: Host, points: Sequence[Derivatives | None], allowed: tuple[float, float]) -> str:
    for state, point in zip(host.states, points, strict=True):
        for name, right, off in zip(_REFERENCE, point or (), allowed, strict=False):
            if not abs(state_value(state, name) - right) <= off + 1e-4 * abs(right):
                return f"{name} is {state_value(state, name):g} in STATE {state.sequence}, {right:g} is right"
    return "" if any(points) else "it was not armed"


def check_force_direction(host: Host, bench: Bench, by: float) -> str:
    """Check that the feedback force moved towards the reference by at least `by` [N, in the box's size].

    Raises InconclusiveError: the current stayed small and the force constant, as with a valve's overlap.
    """
    states, force, by = confirmed_states(host), feedback_field(host), host.force_scale * by
    moved = state_value(states[-1], force) - state_value(states[0], force)
    asked = state_value(states[-1], "reference_force") - state_value(states[0], force)
    if moved * asked > 0.0 and abs(moved) >= by:
        return ""
    largest = max(abs(state_value(state, "valve_current")) for state in states)
    drives = state_value(states[-1], "valve_current") * asked > 0.0
    if drives and abs(moved) < by and largest < _SMALL * box_info(host).valve_current_max:
        why = "an overlap holds the piston there, or the valve is not connected: its sign is not proven"
        raise InconclusiveError(f"the force stood while the current stayed within {1e3 * largest:.2g} mA: {why}")
    return f"asked for {asked:g} N, the force went by {moved:g} N"


def check_rates(host: Host, bench: Bench) -> str:
    """Check that rates are differences through a first-order low-pass with the lags given in DETAILS."""
    if host.details is None:
        raise NotReportedError("no DETAILS came, which tell the ages of the rates")
    told = host.details.details
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
            wanted = memory * state_value(a, rate) + (1.0 - memory) * slope
            if not abs(state_value(b, rate) - wanted) <= tolerance + 1e-3 * abs(wanted):
                found = f"{rate} is {state_value(b, rate):g} in STATE {b.sequence}"
                return f"{found}, {wanted:g} is right for an age of {1e3 * age:g} ms"
    return ""


def check_units(host: Host, bench: Bench, share: float = 0.05) -> str:
    """Check that readings are in Pa, m and N: within the bench's ranges, with f_h equal to that of the pressures.

    `share`: of piston area times supply pressure, by which f_h may differ.
    """
    assert bench is not None
    for state in host.new_states:
        a, b, position = (state_value(state, name) for name in ("pressure_a", "pressure_b", "piston_position"))
        if not all(-0.1 * bench["supply_pressure"] <= p <= 1.5 * bench["supply_pressure"] for p in (a, b)):
            return f"pressures of {a:g} and {b:g} Pa"
        if not -0.1 * bench["stroke"] <= position <= 1.1 * bench["stroke"]:
            return f"a position of {position:g} m"
        wanted = bench["piston_area"] * (a - bench["area_ratio"] * b)
        if (
            not abs(state_value(state, "hydraulic_force") - wanted)
            <= share * bench["piston_area"] * bench["supply_pressure"]
        ):
            return f"hydraulic_force is {state_value(state, 'hydraulic_force'):g} N, the pressures give {wanted:g} N"
        if not all(map(isfinite, state.values)):
            return "a value is not finite"
    return ""


_SMALL = 0.05
"""Share of the largest current within which a valve may have overlap."""
_CLOSE = 2e-6
"""Rounding of float32 in a number of the shaping, relative to its limits."""

_KINK = 4e-3
"""Time constant [s] with which a jump of f_r'' comes into f_c."""


def check_law_limits(host: Host, bench: Bench) -> str:
    """Check that the safe state in the LAW frame is within its limits, and acts while the box is disarmed."""
    law = _record(host)
    for entry in fields(law):
        number = getattr(law, entry.name)
        if not all(map(isfinite, number if isinstance(number, tuple) else (number,))):
            return f"{entry.name} is not finite"
    for low, safe, high, rate in zip(*law.shaping, strict=True):
        if not (low <= safe <= high and rate > 0.0):
            return f"{safe:g} is safe, the limits are {low:g} and {high:g}, the fastest change is {rate:g} a second"
    if not (law.delta_kp_min <= 0.0 <= law.delta_kp_max and law.delta_ki_min <= 0.0 <= law.delta_ki_max):
        return "its limits of the gains do not hold 0"
    for state in confirmed_states(host):
        acting = state.law_state
        if acting.law is not Law.COMPENSATED or not all(map(equal_float32, acting.coefficients, NEUTRAL)):
            return f"law {acting.law.name} with {acting.coefficients} acts in STATE {state.sequence}"
        if (
            acting.compensated_reference != state_value(state, feedback_field(host))
            or acting.compensated_reference_rate != 0.0
        ):
            return f"f_c is {acting.compensated_reference:g} N while it is disarmed"
    return "" if confirmed_states(host) else "no command was confirmed"


def check_compensated_reference(host: Host, bench: Bench, tolerance: float = 0.02) -> str:
    """Check gains, shaping and f_c of each armed sample against the one before and the command in force.

    `tolerance` is of f_c [N], in the box's size, and 50 times as much of f_c' [N/s].

    The shaping goes to the one that was commanded, within its limits, no faster than LAW says; to the safe one where
    the command is late or for the paper's law. f_r and f_r' are the box's own, f_r'' and f_r''' those of its command.
    """
    return _either(
        _compensation(host, points, host.force_scale * tolerance)
        for points in expected_references(host, feedback_field(host))
    )


def _compensation(host: Host, points: Sequence[Derivatives | None], tolerance: float) -> str:
    law, commands = _record(host), {each.sequence: each.command for each in host.sent}
    low, safe, high, rate = law.shaping
    room = [_CLOSE * max(abs(least), abs(most)) for least, most in zip(low, high, strict=True)]
    old, second, third = safe, 0.0, 0.0
    for state, point in zip(host.states, points, strict=True):
        if point is None:
            old, second, third = safe, 0.0, 0.0
            continue
        wanted, gains = _wanted(law, commands.get(state.last_command), late=bool(state.flags & Flag.WATCHDOG))
        shown = state_value(state, "proportional_gain"), state_value(state, "integral_gain")
        if not all(map(equal_float32, shown, gains)):
            return f"the gains are {shown} in STATE {state.sequence}, {gains} is right"
        found = _numbers(state.law_state)
        for number, last, new, least, most, fastest, off in zip(found, old, wanted, low, high, rate, room, strict=True):
            right = last + min(max(new - last, -fastest * SAMPLE_PERIOD), fastest * SAMPLE_PERIOD)
            if not abs(number - right) <= off or not least - off <= number <= most + off:
                return f"{number:g} acts in STATE {state.sequence}, {right:g} is right: {last:g} before, {new:g} wanted"
        middle = second + 0.5 * SAMPLE_PERIOD * (point[3] + third)
        second = middle + (point[2] - middle) * SAMPLE_PERIOD / (SAMPLE_PERIOD + _KINK)
        third = point[3]
        wave = state_value(state, "reference_force"), state_value(state, "reference_force_rate")
        slopes = wave[1], point[2], third + (point[2] - second) / _KINK, 0.0
        if sentence := _reference(law, state, old, (*wave, second, 1.0), slopes, tolerance):
            return sentence
        old = found
    return "" if any(points) else "it was not armed"


def _reference(
    law: BoxLaw, state: State, old: Sequence[float], terms: Sequence[float], slopes: Sequence[float], tolerance: float
) -> str:
    """Compare f_c and f_c' with their formula; what is wrong, or nothing."""
    acting = state.law_state
    a, changes = acting.coefficients, [new - last for new, last in zip(acting.coefficients, old[:4], strict=True)]
    right = sum(number * term for number, term in zip(a, terms, strict=True))
    moved = sum(change * term for change, term in zip(changes, terms, strict=True)) / SAMPLE_PERIOD
    right_rate = moved + sum(number * slope for number, slope in zip(a, slopes, strict=True))
    if abs(right) > law.reference_max:
        right, right_rate = copysign(law.reference_max, right), 0.0
    if not abs(acting.compensated_reference - right) <= tolerance:
        return f"f_c is {acting.compensated_reference:g} N in STATE {state.sequence}, {right:g} N is right"
    if not abs(acting.compensated_reference_rate - right_rate) <= 50.0 * tolerance:
        return (
            f"f_c' is {acting.compensated_reference_rate:g} N/s in STATE {state.sequence}, {right_rate:g} N/s is right"
        )
    return ""


def _wanted(law: BoxLaw, command: Command | None, *, late: bool) -> tuple[list[float], tuple[float, float]]:
    """Shaping that a box goes to, and its gains."""
    low, safe, high, _ = law.shaping
    if late or command is None or command.law is not Law.COMPENSATED:
        return safe, (law.base_kp, law.base_ki)
    asked = (*command.coefficients, command.velocity_compensation, command.valve_gain_scale)
    taken = [_taken(*each) for each in zip(asked, safe, low, high, strict=True)]
    kp = law.base_kp + _taken(command.delta_kp, 0.0, law.delta_kp_min, law.delta_kp_max)
    return taken, (kp, law.base_ki + _taken(command.delta_ki, 0.0, law.delta_ki_min, law.delta_ki_max))


def _taken(number: float, safe: float, low: float, high: float) -> float:
    return min(max(number, low), high) if isfinite(number) else safe


def _numbers(acting: LawState) -> list[float]:
    return [*acting.coefficients, acting.velocity_compensation, acting.valve_gain_scale]


def _record(host: Host) -> BoxLaw:
    assert host.law is not None, "its case needs a compensated law"
    return host.law


CHECKS: dict[str, Callable[..., str]] = {
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
