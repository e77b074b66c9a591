# SPDX-License-Identifier: Apache-2.0
"""Checks of the compensated law: what a box tells of it, its shaping from sample to sample, and f_c."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields
from math import isfinite

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.readings import Bench, followed, near, settled, value
from hydro_bridge.serial.frames import BoxLaw, LawState
from hydro_bridge.serial.protocol import State
from hydro_bridge.signals import NEUTRAL, SAMPLE_PERIOD, Command, Flag, Law

_CLOSE = 2e-6
"""Rounding of float32 in a number of the shaping, relative to its limits."""

_KINK = 4e-3
"""Time constant [s] with which a jump of f_r'' comes into f_c."""


def law_told(host: Host, bench: Bench) -> str:
    """Check that the safe state that LAW tells is within its limits, and acts while the box is disarmed."""
    law = _record(host)
    for entry in fields(law):
        number = getattr(law, entry.name)
        if not all(map(isfinite, number if isinstance(number, tuple) else (number,))):
            return f"{entry.name} is not finite"
    for low, safe, high, rate in zip(*_shaping(law), strict=True):
        if not (low <= safe <= high and rate > 0.0):
            return f"{safe:g} is safe, the limits are {low:g} and {high:g}, the fastest change is {rate:g} a second"
    if not (law.delta_kp_min <= 0.0 <= law.delta_kp_max and law.delta_ki_min <= 0.0 <= law.delta_ki_max):
        return "its limits of the gains do not hold 0"
    for state in settled(host):
        acting = _acting(state)
        if acting.law is not Law.COMPENSATED or not all(map(near, acting.coefficients, NEUTRAL)):
            return f"law {acting.law.name} with {acting.coefficients} acts in STATE {state.sequence}"
        if acting.compensated_reference != value(state, followed(host)) or acting.compensated_reference_rate != 0.0:
            return f"f_c is {acting.compensated_reference:g} N while it is disarmed"
    return "" if settled(host) else "no command was confirmed"


def compensation(host: Host, bench: Bench, tolerance: float = 0.02) -> str:
    """Check gains, shaping and f_c of each armed sample against the one before and the command in force.

    The shaping goes to the one that was commanded, within its limits, no faster than LAW says; to the safe one where
    the command is late or for the paper's law. f_r'' is the difference of f_r': within an allowance where that jumps,
    which goes as the jump comes into f_c. There and everywhere f_c goes where f_c' says. At arming f_r'' begins at 0.
    """
    law, commands = _record(host), {each.sequence: each.command for each in host.sent}
    low, _, high, rate = _shaping(law)
    seen, bend, jump = 0, 0.0, 0.0
    for before, state, behind in zip(host.states, host.states[1:], host.states[2:], strict=False):
        rates = [value(each, "reference_force_rate") for each in (before, state, behind)]
        last_bend, bend = bend, abs(rates[2] - 2.0 * rates[1] + rates[0]) / SAMPLE_PERIOD
        jump = max(bend + last_bend, jump * _KINK / (_KINK + SAMPLE_PERIOD))
        if not all(each.flags & Flag.ARMED for each in (before, state, behind)):
            continue
        wanted, gains = _wanted(law, commands.get(state.last_command), late=bool(state.flags & Flag.WATCHDOG))
        shown = value(state, "proportional_gain"), value(state, "integral_gain")
        if not all(map(near, shown, gains)):
            return f"the gains are {shown} in STATE {state.sequence}, {gains} is right"
        found, last = _numbers(_acting(state)), _numbers(_acting(before))
        for number, old, new, least, most, fastest in zip(found, last, wanted, low, high, rate, strict=True):
            step, room = fastest * SAMPLE_PERIOD, _CLOSE * max(abs(least), abs(most))
            right = old + min(max(new - old, -step), step)
            if not abs(number - right) <= room or not least - room <= number <= most + room:
                return f"{number:g} acts in STATE {state.sequence}, {right:g} is right: {old:g} before, {new:g} wanted"
        if sentence := _reference(law, before, state, rates, jump, tolerance):
            return sentence
        seen += 1
    return "" if seen else "it was not armed"


def _reference(law: BoxLaw, before: State, state: State, rates: Sequence[float], jump: float, tolerance: float) -> str:
    """Compare f_c with the formula, and f_c' by what is known of it; what is wrong, or nothing.

    `rates` are f_r' [N/s] before, now and behind; `jump` is what f_r'' [N/s^2] may be off.
    """
    acting, last = _acting(state), _acting(before)
    second = (rates[2] - rates[0]) / (2.0 * SAMPLE_PERIOD)
    terms = (value(state, "reference_force"), rates[1], second, 1.0)
    a, changes = acting.coefficients, [new - old for new, old in zip(acting[3], last[3], strict=True)]
    right = sum(number * term for number, term in zip(a, terms, strict=True))
    allowed = tolerance + abs(a[2]) * jump
    if abs(right) > law.reference_max - allowed:
        return "" if abs(acting.compensated_reference) <= law.reference_max * (1.0 + _CLOSE) else "f_c is not cut off"
    if not abs(acting.compensated_reference - right) <= allowed:
        return f"f_c is {acting.compensated_reference:g} N in STATE {state.sequence}, {right:g} N is right"
    moved = sum(change * term for change, term in zip(changes, terms, strict=True)) / SAMPLE_PERIOD
    right = a[0] * rates[1] + a[1] * second + moved
    allowed = 1.0 + (abs(a[1]) + 2.0 * abs(a[2]) / SAMPLE_PERIOD) * jump
    if not abs(acting.compensated_reference_rate - right) <= allowed:
        return f"f_c' is {acting.compensated_reference_rate:g} N/s in STATE {state.sequence}, {right:g} N/s is right"
    moved = acting.compensated_reference - last.compensated_reference
    allowed = tolerance + abs(a[1]) * jump * SAMPLE_PERIOD
    if not abs(moved - SAMPLE_PERIOD * acting.compensated_reference_rate) <= allowed:
        return f"f_c moves by {moved:g} N to STATE {state.sequence}, f_c' is {acting.compensated_reference_rate:g} N/s"
    return ""


def _wanted(law: BoxLaw, command: Command | None, *, late: bool) -> tuple[list[float], tuple[float, float]]:
    """Shaping that a box goes to, and its gains."""
    low, safe, high, _ = _shaping(law)
    if late or command is None or command.law is not Law.COMPENSATED:
        return safe, (law.base_kp, law.base_ki)
    asked = (*command.coefficients, command.velocity_compensation, command.valve_gain_scale)
    taken = [_taken(*each) for each in zip(asked, safe, low, high, strict=True)]
    kp = law.base_kp + _taken(command.delta_kp, 0.0, law.delta_kp_min, law.delta_kp_max)
    return taken, (kp, law.base_ki + _taken(command.delta_ki, 0.0, law.delta_ki_min, law.delta_ki_max))


def _taken(number: float, safe: float, low: float, high: float) -> float:
    return min(max(number, low), high) if isfinite(number) else safe


def _shaping(law: BoxLaw) -> tuple[list[float], list[float], list[float], list[float]]:
    """Lowest, safe, highest, and fastest change of a_0 to a_3, C_1, C_2."""
    low = [*law.coefficient_min, law.velocity_compensation_min, law.valve_gain_scale_min]
    safe = [*NEUTRAL, law.velocity_compensation, law.valve_gain_scale]
    high = [*law.coefficient_max, law.velocity_compensation_max, law.valve_gain_scale_max]
    return low, safe, high, [*law.coefficient_rate, law.scale_rate, law.scale_rate]


def _numbers(acting: LawState) -> list[float]:
    return [*acting.coefficients, acting.velocity_compensation, acting.valve_gain_scale]


def _record(host: Host) -> BoxLaw:
    assert host.law is not None, "its case needs a compensated law"
    return host.law


def _acting(state: State) -> LawState:
    assert state.law_state is not None
    return state.law_state
