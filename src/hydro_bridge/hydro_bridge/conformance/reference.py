# SPDX-License-Identifier: Apache-2.0
"""Independent implementation of protocol.md's references and force law; shares no code with any box."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import comb, pi, sin, sqrt
from typing import Any

from hydro_bridge.conformance.host import Host
from hydro_core.signals import STATE_FIELDS, Flag, ReferenceSignal, Waveform

FADE_TIME = 0.3
"""Duration of a cross-fade [s]."""

_FREQUENCY_RATIOS = tuple(map(sqrt, (1.0, 3.0, 7.0, 13.0)))
_AMPLITUDE_WEIGHTS = tuple(1.0 / ratio / sum(1.0 / other for other in _FREQUENCY_RATIOS) for ratio in _FREQUENCY_RATIOS)

Derivatives = tuple[float, ...]
"""Value [N] and its first three derivatives by time [s]."""


def evaluate_signal(signal: ReferenceSignal, time: float) -> Derivatives:
    """Return value [N] and three time derivatives of a signal `time` [s] after the box accepted it."""
    omega = 2.0 * pi * signal.frequency
    angle = omega * time + signal.phase
    if signal.waveform is Waveform.HOLD:
        form: Derivatives = (0.0,) * 4
    elif signal.waveform is Waveform.SINE:
        form = _sine(angle, omega)
    elif signal.waveform is Waveform.MULTISINE:
        inner = [ratio * omega * time + (i + 1) * signal.phase for i, ratio in enumerate(_FREQUENCY_RATIOS)]
        parts = [
            _sine(each, ratio * omega, w)
            for w, ratio, each in zip(_AMPLITUDE_WEIGHTS, _FREQUENCY_RATIOS, inner, strict=True)
        ]
        form = tuple(map(sum, zip(*parts, strict=True)))
    else:  # from -1 to 1 in the eighth of a period after angle 0, and back after pi
        turn = angle / (2.0 * pi) % 1.0
        side, inside = (1.0, turn) if turn < 0.5 else (-1.0, turn - 0.5)
        moves = inside < 0.125
        form = _sine(8.0 * pi * inside - pi / 2, 4.0 * omega, side) if moves else (side, 0.0, 0.0, 0.0)
    value, *rates = (signal.amplitude * each for each in form)
    return signal.offset + value, *rates


def _sine(angle: float, omega: float, weight: float = 1.0) -> Derivatives:
    return tuple(weight * omega**n * sin(angle + n * pi / 2) for n in range(4))


def cross_fade(old: Derivatives, new: Derivatives, time: float, end: float) -> Derivatives:
    """Return value and derivatives `time` [s] into the cross-fade from `old` to `new`, which lasts until `end` [s]."""
    if time >= end:
        return new
    z = time / FADE_TIME
    share = (
        3.0 * z**2 - 2.0 * z**3,
        6.0 * z * (1.0 - z) / FADE_TIME,
        (6.0 - 12.0 * z) / FADE_TIME**2,
        -12.0 / FADE_TIME**3,
    )
    gap = [after - before for before, after in zip(old, new, strict=True)]
    return tuple(old[n] + sum(comb(n, j) * share[j] * gap[n - j] for j in range(n + 1)) for n in range(4))


FORCE_GAIN_SHARE_MIN = 0.1
"""Lower bound of g, relative to g of the bench at rest."""


def _gain(bench: Mapping[str, Any], position: float, pressures: tuple[float, float], opening: float) -> float:
    """g [N/s/A]."""
    area, alpha = bench["piston_area"], bench["area_ratio"]
    flow = bench["valve_nominal_flow"] / bench["valve_nominal_current"] / sqrt(bench["valve_nominal_pressure_drop"] / 2)
    high, low = bench["supply_pressure"], bench["tank_pressure"]
    drops = (high - pressures[0], pressures[1] - low) if opening >= 0 else (pressures[0] - low, high - pressures[1])
    a, b = (flow * (sqrt(drop) if drop >= 0 else -sqrt(-drop)) for drop in drops)
    volume_a, volume_b = _volumes(bench, position)
    result: float = bench["bulk_modulus"] * area * (a / volume_a + alpha * b / volume_b)
    return result


def _volumes(bench: Mapping[str, Any], position: float) -> tuple[float, float]:
    area, alpha = bench["piston_area"], bench["area_ratio"]
    return (
        bench["dead_volume_a"] + area * position,
        bench["dead_volume_b"] + alpha * area * (bench["stroke"] - position),
    )


def nominal_current(
    bench: Mapping[str, Any], values: Mapping[str, float], integral: float, force: str, scales: Sequence[float] = (1, 1)
) -> float:
    """Return the nominal current [A] for `values` of one STATE, by name; `reference_force` and its rate are f_c, f_c'.

    `integral` is I [N/s], `force` the name of the feedback force's field, `scales` are C_1 and C_2. g is limited below
    by `FORCE_GAIN_SHARE_MIN` of its value for the bench at rest: p_a = alpha p_b, p_a + p_b = p_s, the spring relaxed.
    """
    alpha = bench["area_ratio"]
    pressure_b = bench["supply_pressure"] / (1.0 + alpha)
    floor = FORCE_GAIN_SHARE_MIN * _gain(bench, bench["spring_rest_position"], (alpha * pressure_b, pressure_b), 1.0)
    position = min(max(values["piston_position"], 0.0), bench["stroke"])
    volume_a, volume_b = _volumes(bench, position)
    stiffness = bench["bulk_modulus"] * bench["piston_area"] ** 2 * (1 / volume_a + alpha**2 / volume_b)
    error = values["reference_force"] - values[force]
    wanted = values["reference_force_rate"] + values["proportional_gain"] * error + integral
    driven = wanted + scales[0] * stiffness * values["piston_velocity"]
    gain = scales[1] * _gain(bench, position, (values["pressure_a"], values["pressure_b"]), driven)
    return driven / max(gain, floor)


def force_gain(bench: Mapping[str, Any]) -> float:
    """Return the force gain g [N/s/A] at mid-stroke, with half of the supply pressure in both chambers."""
    return float(_gain(bench, bench["stroke"] / 2, (bench["supply_pressure"] / 2,) * 2, 1.0))


_FADE_TIME_TOLERANCE = 1e-6
"""s: rounding of the clock decides whether a fade ends at its 300th or 301st sample."""


def is_acceptable(signal: ReferenceSignal, force_range: float) -> bool:
    """Return whether a box with this force range [N] must accept the reference."""
    numbers = (signal.amplitude, signal.offset, signal.phase, signal.frequency)
    if not all(abs(number) < 3.4e38 for number in numbers):  # NaN, too
        return False
    if signal.amplitude < 0.0 or signal.amplitude + abs(signal.offset) > force_range:
        return False
    return signal.waveform is Waveform.HOLD or 0.0 < signal.frequency < 1000.0


def expected_references(host: Host) -> Iterator[list[Derivatives | None]]:
    """Yield the expected reference at each state (None: disarmed), once for each rounding of a fade's end."""
    reach = host.details.force_range or 1e6
    commands = {each.sequence: each.command for each in host.sent}
    for fade in (FADE_TIME - _FADE_TIME_TOLERANCE, FADE_TIME + _FADE_TIME_TOLERANCE):
        wanted, points = ReferenceSignal(), list[Derivatives | None]()
        old = new = (wanted, 0.0)  # with the time of acceptance, s
        for state in host.states:
            command, time = commands.get(state.last_command), state.time_us * 1e-6
            if command is not None and is_acceptable(command.reference, reach):
                wanted = command.reference
            if not state.flags & Flag.ARMED:
                points.append(None)
                continue
            if not points or points[-1] is None:
                held = ReferenceSignal(offset=state.values[STATE_FIELDS.index(host.feedback)])
                old, new = (held, time), (wanted, time)
            elif time - new[1] >= fade and wanted != new[0]:
                old, new = new, (wanted, time)
            before, after = (evaluate_signal(signal, time - begun) for signal, begun in (old, new))
            points.append(cross_fade(before, after, time - new[1], fade))
        yield points
