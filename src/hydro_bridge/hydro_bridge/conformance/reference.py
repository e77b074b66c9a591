# SPDX-License-Identifier: Apache-2.0
"""Independent implementation of protocol.md's references and force law, and checks of armed boxes against it.

It shares no code with any box. A check disarms the box first, which then gets no command.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from math import comb, isfinite
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import Polynomial

from hydro_bridge.serial.protocol import BoxLaw, State
from hydro_core.signals import (
    SAMPLE_PERIOD,
    STATE_FIELDS,
    Command,
    Flag,
    FloatArray,
    Law,
    ReferenceSignal,
    Waveform,
    flag_names,
)

if TYPE_CHECKING:
    from hydro_bridge.conformance.host import Host

FADE_TIME = 0.3
"""Duration of a cross-fade [s]."""
_RATIOS = np.sqrt([1.0, 3.0, 7.0, 13.0])
_WEIGHTS = 1.0 / _RATIOS / sum(1.0 / _RATIOS)
_FADE = Polynomial([0.0, 0.0, 3.0, -2.0])
SHAPING = ("a_0", "a_1", "a_2", "a_3", "C_1", "C_2")
_FLAT = np.array([[1.0], [0.0], [0.0], [0.0]])


def columns(states: Sequence[State]) -> dict[str, FloatArray]:
    """Return the fields of states by name, those of the force law among them."""
    rows = [(*each.values, *each.law_state[1:3], *each.law_state[3], *each.law_state[4:]) for each in states]
    return dict(zip((*STATE_FIELDS, "f_c", "f_c'", *SHAPING), np.array(rows).T, strict=True))


def expect(states: Sequence[State], name: str, right: Any, tolerance: Any, found: FloatArray | None = None) -> None:
    """Check that a field of states, or `found` in its place, is `right` to within `tolerance`."""
    found = columns(states)[name] if found is None else found
    right = np.broadcast_to(right, found.shape)
    for n in np.flatnonzero(~(np.abs(found - right) <= tolerance))[:1]:  # NaN is wrong, too
        raise AssertionError(f"{name} is {found[n]:g} in STATE {states[n].sequence}, {right[n]:g} is right")


def evaluate_signal(signal: ReferenceSignal, time: FloatArray) -> FloatArray:
    """Return value [N] and three time derivatives of a signal, shape (4, n), `time` [s] after the box accepted it."""
    omega, order = 2.0 * np.pi * signal.frequency, np.arange(4.0)[:, None]

    def sine(angle: FloatArray, rate: float) -> FloatArray:
        return np.asarray(rate**order * np.sin(angle + order * np.pi / 2.0))

    angle = omega * time + signal.phase
    shape: FloatArray = np.zeros((4, len(time)))
    if signal.waveform is Waveform.SINE:
        shape = sine(angle, omega)
    elif signal.waveform is Waveform.MULTISINE:
        for n, (ratio, weight) in enumerate(zip(_RATIOS, _WEIGHTS, strict=True), 1):
            shape += weight * sine(ratio * omega * time + n * signal.phase, ratio * omega)
    elif signal.waveform is Waveform.SMOOTH_STEP:  # each half turn begins with an edge of an eighth of a turn
        turn = angle / (2.0 * np.pi) % 1.0
        edge = np.where(turn % 0.5 < 0.125, sine(8.0 * np.pi * (turn % 0.5) - np.pi / 2.0, 4.0 * omega), _FLAT)
        shape = np.where(turn < 0.5, edge, -edge)
    return signal.offset * _FLAT + signal.amplitude * shape


def expected_reference(
    armed: Sequence[State], commands: Mapping[int, Command], start: float, force_range: float, fade: float
) -> FloatArray:
    """Return f_r and its derivatives, shape (4, n), in the n samples since the box armed at the force `start` [N].

    A cross-fade ends after `fade` [s].
    """
    time, found = 1e-6 * np.array([state.time_us for state in armed]), np.empty((4, len(armed)))
    wanted, signals = ReferenceSignal(), [(0, ReferenceSignal(offset=start))]
    for n, state in enumerate(armed):
        asked = commands[state.last_command].reference
        finite = np.isfinite([asked.amplitude, asked.offset, asked.phase, asked.frequency]).all()
        playable = asked.waveform is Waveform.HOLD or 0.0 < asked.frequency < 1000.0
        if finite and playable and asked.amplitude >= 0.0 and asked.amplitude + abs(asked.offset) <= force_range:
            wanted = asked
        if n == 0 or (wanted != signals[-1][1] and time[n] - time[signals[-1][0]] >= fade):
            signals.append((n, wanted))
    for (before, old), (begin, new) in pairwise(signals):  # each overwrites what follows its begin
        now = time[begin:] - time[begin]
        share = [_FADE.deriv(n)(now / FADE_TIME) / FADE_TIME**n for n in range(4)]
        last, next_ = evaluate_signal(old, time[begin:] - time[before]), evaluate_signal(new, now)
        for n in range(4):
            mixed = last[n] + sum(comb(n, j) * share[j] * (next_ - last)[n - j] for j in range(n + 1))
            found[n, begin:] = np.where(now < fade, mixed, next_[n])
    return found


def force_gain(bench: Mapping[str, Any], position: Any, pressure_a: Any, pressure_b: Any, current: Any) -> FloatArray:
    """Return g [N/s/A] for currents of this sign."""
    high, low = bench["supply_pressure"], bench["tank_pressure"]
    flow = (
        bench["valve_nominal_flow"] / bench["valve_nominal_current"] / (bench["valve_nominal_pressure_drop"] / 2) ** 0.5
    )
    drops = np.where(current >= 0.0, (high - pressure_a, pressure_b - low), (pressure_a - low, high - pressure_b))
    flows = flow * np.sign(drops) * np.sqrt(np.abs(drops))
    volume_a, volume_b = _volumes(bench, position)
    inside = flows[0] / volume_a + bench["area_ratio"] * flows[1] / volume_b
    return np.asarray(bench["bulk_modulus"] * bench["piston_area"] * inside)


def _volumes(bench: Mapping[str, Any], position: Any) -> tuple[Any, Any]:
    area_b = bench["area_ratio"] * bench["piston_area"]
    volume_b = bench["dead_volume_b"] + area_b * (bench["stroke"] - position)
    return bench["dead_volume_a"] + bench["piston_area"] * position, volume_b


def nominal_current(
    bench: Mapping[str, Any], values: Mapping[str, FloatArray], wanted: FloatArray, scales: Sequence[FloatArray]
) -> FloatArray:
    """Return u_nom [A] for `wanted` = f_c' + K_p e + I [N/s]; `values`: STATE's by name, `scales`: C_1 and C_2."""
    alpha, position = bench["area_ratio"], np.clip(values["piston_position"], 0.0, bench["stroke"])
    rest = bench["supply_pressure"] / (1.0 + alpha)
    least = 0.1 * force_gain(bench, bench["spring_rest_position"], alpha * rest, rest, 1.0)
    volume_a, volume_b = _volumes(bench, position)
    stiffness = bench["bulk_modulus"] * bench["piston_area"] ** 2 * (1.0 / volume_a + alpha**2 / volume_b)
    driven = wanted + scales[0] * stiffness * values["piston_velocity"]
    gain = force_gain(bench, position, values["pressure_a"], values["pressure_b"], driven)
    return np.asarray(driven / np.maximum(scales[1] * gain, least))


def _check_reference(host: Host, judge: Callable[[FloatArray], None]) -> None:
    """Judge f_r and its derivatives with either rounding of a fade's end: it is the 300th or the 301st sample."""
    start, force_range = columns(host.armed[:1])[host.feedback][0], host.details.force_range or 1e6
    first, second = (expected_reference(host.armed, host.commands, start, force_range, FADE_TIME + rounding)
                     for rounding in (-1e-6, 1e-6))  # fmt: skip
    try:
        judge(first)
    except AssertionError:
        judge(second)


def check_reference(host: Host) -> None:
    """Check f_r and f_r' against the definition of the accepted references, cross-fades included."""
    host.close()

    def judge(points: FloatArray) -> None:
        for name, right, off in zip(("reference_force", "reference_force_rate"), points, (0.01, 0.5), strict=False):
            expect(host.armed, name, right, host.force_scale * off + 1e-4 * np.abs(right))

    _check_reference(host, judge)


def check_current(host: Host) -> None:
    """Check valve_current = clamp(u_nom + delta_u), delta_u for 3.5 ms from acceptance; SATURATED if clamped."""
    host.close()
    now, limit, since, corrections = columns(host.armed), host.info.valve_current_max, dict[int, int](), []
    for state in host.armed:
        late = state.time_us - since.setdefault(state.last_command, state.time_us) > 3500
        corrections.append(0.0 if late else np.nan_to_num(host.commands[state.last_command].delta_u))
    wanted = now["nominal_valve_current"] + corrections
    right = np.clip(wanted, -limit, limit)
    expect(host.armed, "valve_current", right, 1e-7 + 1e-6 * np.abs(right))
    for state, current in zip(host.armed, wanted, strict=True):
        wrong = bool(state.flags & Flag.SATURATED) != (abs(current) > limit) and abs(abs(current) - limit) > 1e-6
        assert not wrong, f"{current:g} A of {limit:g} A and {flag_names(state.flags)} in STATE {state.sequence}"


def check_law(host: Host, bench: Mapping[str, Any]) -> None:
    """Check u_nom since arming against the force law for the box's measurements and its form of the integral.

    The integral is frozen (anti-windup) while the current is at its limit and K_i e has the current's sign.
    """
    host.close()
    now, paper = columns(host.armed), host.info.integral == "paper"
    gain, current = now["integral_gain"], now["valve_current"]
    error = now["f_c"] - now[host.feedback]
    full = np.abs(current) >= (1.0 - 1e-6) * host.info.valve_current_max
    steps = SAMPLE_PERIOD * np.where(full & (current * gain * error > 0.0), 0.0, error if paper else gain * error)
    integral = (np.cumsum(steps) - steps) * (gain if paper else 1.0)
    right = nominal_current(
        bench, now, now["f_c'"] + now["proportional_gain"] * error + integral, (now["C_1"], now["C_2"])
    )
    expect(host.armed, "nominal_valve_current", right, 2e-7 + 1e-4 * np.abs(right))


def check_compensated(host: Host, law: BoxLaw) -> None:
    """Check gains, shaping and f_c of each armed sample against the one before and the command in force.

    f_r and f_r' are those of STATE, f_r'' and f_r''' of the command.
    """
    host.close()
    now, period = columns(host.armed), SAMPLE_PERIOD
    low, safe, high, rate = np.array(law.shaping_limits)
    least, most = [law.delta_kp_min, law.delta_ki_min, *low], [law.delta_kp_max, law.delta_ki_max, *high]
    wanted = []
    for state in host.armed:
        command, known = host.commands[state.last_command], [0.0, 0.0, *safe]
        asked = [command.delta_kp, command.delta_ki, *command.shaping]
        if state.flags & Flag.WATCHDOG or command.law is not Law.COMPENSATED:
            asked = known
        clear = [number if isfinite(number) else other for number, other in zip(asked, known, strict=True)]
        wanted.append(np.clip(clear, least, most))
    kp, ki, *shaping = np.array(wanted).T
    expect(host.armed, "proportional_gain", law.base_kp + kp, 1e-6 * law.base_kp)
    expect(host.armed, "integral_gain", law.base_ki + ki, 1e-6 * law.base_ki)
    steps = []
    for n, name in enumerate(SHAPING):
        before = np.append(safe[n], now[name][:-1])
        step = np.clip(shaping[n] - before, -rate[n] * period, rate[n] * period)
        expect(host.armed, name, before + step, 2e-6 * max(abs(low[n]), abs(high[n])))
        steps.append((now[name] - before) / period)

    def judge(points: FloatArray) -> None:
        second, smooth, third = 0.0, np.empty(len(points.T)), np.append(0.0, points[3])
        for n, jump in enumerate(points[2]):  # f_r'' through a low-pass of 4 ms
            middle = second + 0.5 * period * (third[n] + third[n + 1])
            smooth[n] = second = middle + (jump - middle) * period / (period + 4e-3)
        force, force_rate = now["reference_force"], now["reference_force_rate"]
        terms: list[Any] = [force, force_rate, smooth, 1.0]
        slopes: list[Any] = [force_rate, points[2], points[3] + (points[2] - smooth) / 4e-3, 0.0]
        right = sum(now[name] * term for name, term in zip(SHAPING, terms, strict=False))
        rates = sum(now[name] * slope + step * term
                    for name, slope, step, term in zip(SHAPING, slopes, steps, terms, strict=False))  # fmt: skip
        beyond = np.abs(right) > law.reference_max
        limited = np.clip(right, -law.reference_max, law.reference_max)
        expect(host.armed, "f_c", limited, 0.02 * host.force_scale)
        expect(host.armed, "f_c'", np.where(beyond, 0.0, rates), 1.0 * host.force_scale)

    _check_reference(host, judge)
