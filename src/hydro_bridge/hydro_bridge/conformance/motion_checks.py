# SPDX-License-Identifier: Apache-2.0
"""Checks of an armed box's behaviour and measurements: currents, force law, reference, rates, units."""

from __future__ import annotations

from itertools import pairwise
from math import isfinite

from hydro_bridge.conformance import generator
from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.law import nominal_current
from hydro_bridge.conformance.readings import SINGLE, Bench, NotToldError, box_info, followed, settled, value
from hydro_bridge.signals import SAMPLE_PERIOD, STATE_FIELDS, Flag, flag_names

_REFERENCE = ("reference_force", "reference_force_rate")
_CORRECTION_HOLD = 3500
"""us, duration for which the correction of a command acts."""


def current(host: Host, bench: Bench) -> str:
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
        wanted = value(state, "nominal_valve_current") + delta
        clamped = min(max(wanted, -limit), limit)
        if not abs(value(state, "valve_current") - clamped) <= 1e-7 + SINGLE * abs(clamped):
            found = f"valve_current is {value(state, 'valve_current'):g} A in STATE {state.sequence}"
            return f"{found}, {clamped:g} A is right"
        if abs(abs(wanted) - limit) > 1e-6 and bool(state.flags & Flag.SATURATED) != (abs(wanted) > limit):
            return f"{wanted:g} A of {limit:g} A and {flag_names(state.flags)} in STATE {state.sequence}"
    return ""


def law(host: Host, bench: Bench, tolerance: float = 2e-7, share: float = 1e-4) -> str:
    """Check u_nom since arming against the force law for the box's measurements and its form of the integral.

    The integral stands still while the current is at its limit and K_i e has the current's sign. Whether the current
    includes the correction is checked by `current`.
    """
    assert bench is not None
    integral, armed, form, force = 0.0, False, box_info(host).integral, followed(host)
    full = (1.0 - SINGLE) * box_info(host).valve_current_max
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


def reference(host: Host, bench: Bench, tolerance: float = 0.01, rate_tolerance: float = 0.5) -> str:
    """Check f_r and f_r' against the definition of the accepted references, cross-fades included."""
    return generator.compare(host, followed(host), tolerance, rate_tolerance)


def follows(host: Host, bench: Bench, by: float) -> str:
    """Check that the followed force moved with the reference, by a least number of N: the signs are right."""
    states, force = settled(host), followed(host)
    moved = value(states[-1], force) - value(states[0], force)
    asked = value(states[-1], "reference_force") - value(states[0], force)
    return "" if moved * asked > 0.0 and abs(moved) >= by else f"asked for {asked:g} N, the force went by {moved:g} N"


def rates(host: Host, bench: Bench) -> str:
    """Check that rates are differences through a first-order low-pass with the lags given in DETAILS."""
    if host.details is None:
        raise NotToldError("no DETAILS came, which tell the ages of the rates")
    told = host.details.details
    pairs = (("hydraulic_force", "hydraulic_force_rate", told.force_rate_age, 0.5),
             ("load_force", "load_force_rate", told.force_rate_age, 0.5),
             ("piston_position", "piston_velocity", told.velocity_age, 3e-5))  # fmt: skip
    if not any(age for _, _, age, _ in pairs):
        raise NotToldError("DETAILS do not tell the ages of the rates")
    for reading, rate, age, tolerance in pairs:
        if age == 0.0:
            host.notes.append(f"the age of {rate} is not told")
            continue
        memory = (age / SAMPLE_PERIOD - 0.5) / (age / SAMPLE_PERIOD + 0.5)
        for a, b in pairwise(host.new_states):
            slope = (value(b, reading) - value(a, reading)) / SAMPLE_PERIOD
            wanted = memory * value(a, rate) + (1.0 - memory) * slope
            if not abs(value(b, rate) - wanted) <= tolerance + 1e-3 * abs(wanted):
                found = f"{rate} is {value(b, rate):g} in STATE {b.sequence}"
                return f"{found}, {wanted:g} is right for an age of {1e3 * age:g} ms"
    return ""


def units(host: Host, bench: Bench, force: float = 150.0) -> str:
    """Check that readings are in Pa, m and N: within the bench's ranges, with f_h equal to that of the pressures."""
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
