# SPDX-License-Identifier: Apache-2.0
"""What is judged of the states that came since the last step began: each check gives a sentence, or nothing."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import isclose, isfinite
from typing import Any

from hydro_bridge.conformance import generator
from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.law import nominal_current
from hydro_bridge.files import bench_file
from hydro_bridge.serial.frames import BoxInfo
from hydro_bridge.serial.protocol import State
from hydro_bridge.signals import SAMPLE_PERIOD, STATE_FIELDS, Flag, flag_names

Bench = Mapping[str, Any] | None
_SINGLE = 1e-6
"""Relative error of a float32, with room for one operation."""

_CORRECTION_HOLD = 3500
"""us for which the correction of a command acts."""


def value(state: State, name: str) -> float:
    """A float field of a state by its name."""
    return state.values[STATE_FIELDS.index(name)]


def _info(host: Host) -> BoxInfo:
    assert host.hello is not None and host.hello.info is not None
    return host.hello.info


def followed(host: Host) -> str:
    """Field of the force that the box's law follows: what DETAILS tell, else the load force."""
    told = host.details.details.feedback if host.details else ""
    return f"{told or 'load'}_force"


def _settled(host: Host) -> Sequence[State]:
    """States from the one that confirms the step's first command on."""
    return host.states[host.confirmed(host.sent[host.marked_sent].sequence) :] if host.new_sent else host.new_states


def flags(host: Host, bench: Bench, has: Sequence[str] = (), lacks: Sequence[str] = ()) -> str:
    """Flags that every settled state has, and that none has."""
    wanted, unwanted = (sum(Flag[name] for name in names) for names in (has, lacks))
    for n, state in enumerate(_settled(host)):
        if state.flags & wanted != wanted or state.flags & unwanted:
            return f"sample {n} has {flag_names(state.flags)}"
    return "" if _settled(host) else "no command was confirmed"


def field(
    host: Host, bench: Bench, name: str, equals: Sequence[str | float], tolerance: float = 1e-3, last: int = 0
) -> str:
    """A field is the sum of numbers and of entries of HELLO, in every settled state or in the last ones."""
    wanted = sum(getattr(_info(host), each) if isinstance(each, str) else float(each) for each in equals)
    states = _settled(host)[-last:]
    for n, state in enumerate(states):
        if not abs(value(state, name) - wanted) <= tolerance:
            return f"{name} is {value(state, name):g} in sample {n}, {wanted:g} is right"
    return "" if states else "no command was confirmed"


def taken(host: Host, bench: Bench, yes: bool = True) -> str:
    """Whether the last command that was sent was taken."""
    sequence = host.sent[-1].sequence
    found = any(state.last_command == sequence for state in host.new_states)
    return "" if found == yes else f"command {sequence} was {'not ' if yes else ''}taken"


def unchanged(host: Host, bench: Bench, name: str) -> str:
    """A field is in each state what it was before the step."""
    before = value(host.states[host.marked - 1], name)
    now = {value(state, name) for state in host.new_states}
    return "" if now <= {before} else f"{name} was {before:g}, and became {max(now):g}"


def first_flag(host: Host, bench: Bench, flag: str, samples: tuple[int, int]) -> str:
    """How many samples behind the last command that was taken a flag comes first."""
    begin = host.confirmed(host.states[-1].last_command)
    states = host.states[begin:]
    found = next((n for n, state in enumerate(states) if state.flags & Flag[flag]), None)
    if found is None:
        return f"{flag} did not come within {len(states)} samples"
    return "" if samples[0] <= found <= samples[1] else f"{flag} came {found} samples behind the last command"


def late(host: Host, bench: Bench) -> str:
    """While WATCHDOG is set: base gains, no correction, FILTER_STALE."""
    info = _info(host)
    for state in host.new_states:
        if not state.flags & Flag.WATCHDOG:
            continue
        gains = value(state, "proportional_gain"), value(state, "integral_gain")
        if not all(map(_near, gains, (info.base_kp, info.base_ki))) or not state.flags & Flag.FILTER_STALE:
            return f"gains {gains[0]:g} and {gains[1]:g}, {flag_names(state.flags)}"
        if value(state, "valve_current") != value(state, "nominal_valve_current") and not state.flags & Flag.SATURATED:
            return "the correction is still added"
    return "" if any(state.flags & Flag.WATCHDOG for state in host.new_states) else "WATCHDOG did not come"


def undisturbed(host: Host, bench: Bench) -> str:
    """No sample is missing, none comes twice, and every frame is whole."""
    steps = {(b.sequence - a.sequence) % 2**32 for a, b in pairwise(host.new_states)}
    counts = host.decoder.counts
    if steps != {1}:
        return f"sequence steps of {sorted(steps)}"
    return f"{counts.crc_errors} check sums, {counts.malformed} frames are wrong" if counts.malformed else ""


def clock(host: Host, bench: Bench, jitter: float = 200.0, share: float = 0.01) -> str:
    """The box's clock: each step within `jitter` [us] of a period, and its pace within `share` of the host's."""
    times = [state.time_us for state in host.new_states]
    steps = [b - a for a, b in pairwise(times)]
    if max(abs(step - 1e6 * SAMPLE_PERIOD) for step in steps) > jitter:
        return f"steps of {min(steps)} to {max(steps)} us"
    arrived = host.arrived[host.marked :]
    pace = (times[-1] - times[0]) * 1e-6 / (arrived[-1] - arrived[0])
    return "" if abs(pace - 1.0) <= share else f"{pace:.4f} s of the box are 1 s of the host"


def hello(host: Host, bench: Bench) -> str:
    """HELLO is whole: a name, ordered limits that hold zero, 1 ms, a form of the integral."""
    info = _info(host)
    if not info.name:
        return "it has no name"
    if not info.integral:
        return "it does not tell the form of its integral"
    if not _near(info.sample_period, SAMPLE_PERIOD):
        return f"its sample period is {info.sample_period:g} s"
    if not (info.delta_kp_min <= 0.0 <= info.delta_kp_max and info.delta_ki_min <= 0.0 <= info.delta_ki_max):
        return "its limits of the gains do not hold 0"
    return "" if info.valve_current_max > 0.0 <= info.delta_u_max else "its limits of the current are not positive"


def greeted(host: Host, bench: Bench, within: int, versions: tuple[int, int] | None = None) -> str:
    """The last HELLO was answered within so many samples, by one with sequence 1 or more."""
    answers = [(n - host.greeted_at, each) for n, each in host.hellos if n >= host.greeted_at]
    if not answers or answers[0][0] > within:
        return f"no HELLO came within {within} samples"
    if answers[0][1].sequence == 0:
        return "the answer has sequence 0, which says power-on"
    return ""


def speaks(host: Host, bench: Bench, version: int) -> str:
    """STATE and DETAILS are those of this version once the greeting was answered."""
    begin = next((n for n, _ in host.hellos if n >= host.greeted_at), host.greeted_at)
    found = {1 if state.refused is None else 2 for state in host.states[begin + 1 :]}
    if found != {version}:
        return f"STATE of version {sorted(found)}"
    return "" if (host.details is not None) == (version > 1) else "DETAILS are there in version 2, and only there"


def details(host: Host, bench: Bench) -> str:
    """DETAILS are whole: an epoch, times and ranges in order."""
    if host.details is None:
        return "none came"
    told = host.details.details
    if not told.epoch:
        return "its epoch is 0"
    if not 0.0 < told.hold_timeout <= told.trip_timeout:
        return f"its time-outs are {told.hold_timeout:g} and {told.trip_timeout:g} s"
    ordered = told.pressure_min < told.pressure_max and told.position_min < told.position_max
    return "" if ordered and told.load_force_limit > 0.0 < told.force_range else "a limit is 0, or a range is empty"


def believes(host: Host, bench: Bench) -> str:
    """What HELLO and DETAILS say agrees with the bench file."""
    assert bench is not None
    if not _near(_info(host).valve_current_max, bench["valve_current_max"]):
        return f"valve_current_max {_info(host).valve_current_max:g} A, the file has {bench['valve_current_max']:g} A"
    told = host.details.details.bench_digest if host.details else ""
    if told and told != bench_file.digest(bench):
        return f"its bench is {told}, the file is {bench_file.digest(bench)}"
    return ""


def refused(host: Host, bench: Bench, values: int, references: int) -> str:
    """How many values and references the box counted as refused in this step, per command that it took."""
    before, after = host.states[host.marked - 1], host.states[-1]
    found = [((b or 0) - (a or 0)) for a, b in zip(before[5:7], after[5:7], strict=True)]
    return "" if found == [values, references] else f"it counted {found[0]} values and {found[1]} references"


def idle(host: Host, bench: Bench, last: int = 0) -> str:
    """What a box shows that is not armed: no current, and the reference rests on the force that it follows."""
    force = followed(host)
    for state in _settled(host)[-last:]:
        if any(value(state, name) != 0.0 for name in ("valve_current", "nominal_valve_current")):
            return "a current is not 0"
        if value(state, "reference_force") != value(state, force) or value(state, "reference_force_rate") != 0.0:
            return f"reference_force is not {force}, or its rate is not 0"
        if state.flags & Flag.ARMED:
            return "it is armed"
    return "" if _settled(host) else "no command was confirmed"


def current(host: Host, bench: Bench) -> str:
    """valve_current = clamp(nominal + delta_u), delta_u for 3.5 ms from where it was taken; SATURATED if clamped."""
    limit, commands = _info(host).valve_current_max, {each.sequence: each.command for each in host.sent}
    newest, since = None, 0
    for n, state in enumerate(host.states):
        if state.last_command != newest:
            newest, since = state.last_command, state.time_us
        command = commands.get(state.last_command)
        if n < host.marked or not state.flags & Flag.ARMED or command is None:
            continue
        delta = command.delta_u if state.time_us - since <= _CORRECTION_HOLD else 0.0
        wanted = value(state, "nominal_valve_current") + delta
        clamped = min(max(wanted, -limit), limit)
        if not abs(value(state, "valve_current") - clamped) <= 1e-7 + _SINGLE * abs(clamped):
            return f"valve_current {value(state, 'valve_current'):g} A, {clamped:g} A is right"
        if abs(abs(wanted) - limit) > 1e-6 and bool(state.flags & Flag.SATURATED) != (abs(wanted) > limit):
            return f"{wanted:g} A of {limit:g} A and {flag_names(state.flags)}"
    return ""


def law(host: Host, bench: Bench, tolerance: float = 2e-7, share: float = 1e-4) -> str:
    """u_nom since arming is that of the force law for what the box measured, with the integral that it tells.

    Where the integral stands is told by the current: at its limit, and K_i e has the current's sign. Whether the
    correction came into it is what `current` checks.
    """
    assert bench is not None
    integral, armed, form, force = 0.0, False, _info(host).integral, followed(host)
    full = (1.0 - _SINGLE) * _info(host).valve_current_max
    for n, state in enumerate(host.states):
        names = dict(zip(STATE_FIELDS, state.values, strict=True))
        if not state.flags & Flag.ARMED:
            integral, armed = 0.0, False
            continue
        armed = True
        action = integral if form != "paper" else names["integral_gain"] * integral
        wanted = nominal_current(bench, names, action, force)
        if not abs(names["nominal_valve_current"] - wanted) <= tolerance + share * abs(wanted):
            return f"nominal_valve_current is {names['nominal_valve_current']:g} A in sample {n}, {wanted:g} A is right"
        error = names["reference_force"] - names[force]
        slope, current = names["integral_gain"] * error, names["valve_current"]
        if not (abs(current) >= full and current * slope > 0.0):
            integral += SAMPLE_PERIOD * (slope if form != "paper" else error)
    return "" if armed else "it was not armed"


def reference(host: Host, bench: Bench, tolerance: float = 0.01, rate_tolerance: float = 0.5) -> str:
    """f_r and f_r' are those of the commands that were taken, by their definition, fades included."""
    return generator.compare(host, followed(host), tolerance, rate_tolerance)


def follows(host: Host, bench: Bench, by: float) -> str:
    """The followed force went the way of the reference, by so many N at least: the signs are right."""
    states, force = _settled(host), followed(host)
    moved = value(states[-1], force) - value(states[0], force)
    asked = value(states[-1], "reference_force") - value(states[0], force)
    return "" if moved * asked > 0.0 and abs(moved) >= by else f"asked for {asked:g} N, the force went by {moved:g} N"


def rates(host: Host, bench: Bench) -> str:
    """Rates are differences behind a first-order low-pass of the ages that DETAILS tell."""
    assert host.details is not None
    told = host.details.details
    pairs = (("hydraulic_force", "hydraulic_force_rate", told.force_rate_age, 0.5),
             ("load_force", "load_force_rate", told.force_rate_age, 0.5),
             ("piston_position", "piston_velocity", told.velocity_age, 3e-5))  # fmt: skip
    for reading, rate, age, tolerance in pairs:
        if age == 0.0:
            continue
        memory = (age / SAMPLE_PERIOD - 0.5) / (age / SAMPLE_PERIOD + 0.5)
        for a, b in pairwise(host.new_states):
            slope = (value(b, reading) - value(a, reading)) / SAMPLE_PERIOD
            wanted = memory * value(a, rate) + (1.0 - memory) * slope
            if not abs(value(b, rate) - wanted) <= tolerance + 1e-3 * abs(wanted):
                return f"{rate} is {value(b, rate):g}, {wanted:g} is right for an age of {1e3 * age:g} ms"
    return ""


def units(host: Host, bench: Bench, force: float = 150.0) -> str:
    """Readings are in Pa, m and N: within the bench, and f_h is that of the pressures."""
    assert bench is not None
    for state in host.new_states:
        a, b, position = (value(state, name) for name in ("pressure_a", "pressure_b", "piston_position"))
        if not all(-0.1 * bench["supply_pressure"] <= p <= 1.5 * bench["supply_pressure"] for p in (a, b)):
            return f"pressures of {a:g} and {b:g} Pa"
        if not -0.1 * bench["stroke"] <= position <= 1.1 * bench["stroke"]:
            return f"a position of {position:g} m"
        wanted = bench["piston_area"] * (a - bench["area_ratio"] * b)
        if not abs(value(state, "hydraulic_force") - wanted) <= force:
            return f"hydraulic_force is {value(state, 'hydraulic_force'):g} N, the pressures give {wanted:g} N"
        if not all(map(isfinite, state.values)):
            return "a value is not finite"
    return ""


def _near(one: float, other: float) -> bool:
    return isclose(one, other, rel_tol=_SINGLE, abs_tol=1e-12)


CHECKS: dict[str, Callable[..., str]] = {
    each.__name__: each
    for each in (
        flags,
        field,
        taken,
        unchanged,
        first_flag,
        late,
        undisturbed,
        clock,
        hello,
        greeted,
        speaks,
        details,
        believes,
        refused,
        idle,
        current,
        law,
        reference,
        follows,
        rates,
        units,
    )
}
"""By the name in `cases.yaml`."""
