# SPDX-License-Identifier: Apache-2.0
"""Checks of the box's response to commands: flags, fields, acceptance, time-outs, refusals."""

from __future__ import annotations

from collections.abc import Sequence

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.readings import Bench, box_info, followed, near, settled, value
from hydro_bridge.signals import Flag, flag_names


def flags(host: Host, bench: Bench, has: Sequence[str] = (), lacks: Sequence[str] = ()) -> str:
    """Check which flags are set in every settled state, and which in none."""
    wanted, unwanted = (sum(Flag[name] for name in names) for names in (has, lacks))
    for state in settled(host):
        if state.flags & wanted != wanted or state.flags & unwanted:
            return f"STATE {state.sequence} has {flag_names(state.flags)}"
    return "" if settled(host) else "no command was confirmed"


def field(
    host: Host, bench: Bench, name: str, equals: Sequence[str | float], tolerance: float = 1e-3, last: int = 0
) -> str:
    """Check that a field equals the sum of numbers and entries of HELLO, in every settled state or the last ones."""
    wanted = sum(getattr(box_info(host), each) if isinstance(each, str) else float(each) for each in equals)
    states = settled(host)[-last:]
    for state in states:
        if not abs(value(state, name) - wanted) <= tolerance:
            return f"{name} is {value(state, name):g} in STATE {state.sequence}, {wanted:g} is right"
    return "" if states else "no command was confirmed"


def taken(host: Host, bench: Bench, yes: bool = True) -> str:
    """Check whether the last command sent was accepted."""
    sequence = host.sent[-1].sequence
    found = any(state.last_command == sequence for state in host.new_states)
    return "" if found == yes else f"command {sequence} was {'not ' if yes else ''}taken"


def unchanged(host: Host, bench: Bench, name: str) -> str:
    """Check that a field keeps the value from before the step in every state."""
    before = value(host.states[host.marked - 1], name)
    now = {value(state, name) for state in host.new_states}
    return "" if now <= {before} else f"{name} was {before:g}, and became {max(now):g}"


def first_flag(host: Host, bench: Bench, flag: str, samples: tuple[int, int]) -> str:
    """Check how many samples after the last accepted command a flag first appears."""
    begin = host.confirmed(host.states[-1].last_command)
    states = host.states[begin:]
    found = next((n for n, state in enumerate(states) if state.flags & Flag[flag]), None)
    if found is None:
        return f"{flag} did not come within {len(states)} samples"
    return "" if samples[0] <= found <= samples[1] else f"{flag} came {found} samples behind the last command"


def late(host: Host, bench: Bench) -> str:
    """Check that the box runs base gains, no correction and FILTER_STALE while WATCHDOG is set."""
    info = box_info(host)
    for state in host.new_states:
        if not state.flags & Flag.WATCHDOG:
            continue
        gains = value(state, "proportional_gain"), value(state, "integral_gain")
        if not all(map(near, gains, (info.base_kp, info.base_ki))) or not state.flags & Flag.FILTER_STALE:
            return f"gains {gains[0]:g} and {gains[1]:g}, {flag_names(state.flags)}"
        if value(state, "valve_current") != value(state, "nominal_valve_current") and not state.flags & Flag.SATURATED:
            return "the correction is still added"
    return "" if any(state.flags & Flag.WATCHDOG for state in host.new_states) else "WATCHDOG did not come"


def refused(host: Host, bench: Bench, values: int, references: int) -> str:
    """Check how many values and references the box counted as refused in this step, per accepted command."""
    before, after = host.states[host.marked - 1], host.states[-1]
    found = [((b or 0) - (a or 0)) for a, b in zip(before[5:7], after[5:7], strict=True)]
    return "" if found == [values, references] else f"it counted {found[0]} values and {found[1]} references"


def idle(host: Host, bench: Bench, last: int = 0) -> str:
    """Check the state of a disarmed box: no current, and the reference equal to the followed force."""
    force = followed(host)
    for state in settled(host)[-last:]:
        if any(value(state, name) != 0.0 for name in ("valve_current", "nominal_valve_current")):
            return "a current is not 0"
        if value(state, "reference_force") != value(state, force) or value(state, "reference_force_rate") != 0.0:
            return f"reference_force is not {force}, or its rate is not 0"
        if state.flags & Flag.ARMED:
            return "it is armed"
    return "" if settled(host) else "no command was confirmed"
