# SPDX-License-Identifier: Apache-2.0
"""Independent implementation of protocol.md's references and force law; shares no code with any box."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import cos, pi, sin, sqrt
from typing import Any

from hydro_bridge.conformance.host import Host
from hydro_bridge.serial.frames import BoxInfo
from hydro_bridge.serial.protocol import State
from hydro_bridge.signals import STATE_FIELDS, Flag, ReferenceSignal, Waveform

FADE = 0.3
"""s, length of a cross-fade."""

_RATIOS = tuple(map(sqrt, (1.0, 3.0, 7.0, 13.0)))
_WEIGHTS = tuple(1.0 / ratio / sum(1.0 / other for other in _RATIOS) for ratio in _RATIOS)

Point = tuple[float, float]
"""Value [N] and rate [N/s]."""


def shape(signal: ReferenceSignal, time: float) -> Point:
    """Return a signal's point at `time` [s] after the box accepted it."""
    omega = 2.0 * pi * signal.frequency
    angle = omega * time + signal.phase
    if signal.waveform is Waveform.HOLD:
        value, slope = 0.0, 0.0
    elif signal.waveform is Waveform.SINE:
        value, slope = sin(angle), cos(angle)
    elif signal.waveform is Waveform.MULTISINE:
        inner = [ratio * omega * time + (i + 1) * signal.phase for i, ratio in enumerate(_RATIOS)]
        value = sum(weight * sin(each) for weight, each in zip(_WEIGHTS, inner, strict=True))
        slope = sum(w * r * cos(each) for w, r, each in zip(_WEIGHTS, _RATIOS, inner, strict=True))
    else:
        value, slope = _smooth_step(angle)
    return signal.offset + signal.amplitude * value, signal.amplitude * omega * slope


def _smooth_step(angle: float) -> Point:
    """Return a step from -1 to 1 in the eighth of a period after angle 0, and back after pi."""
    turn = angle / (2.0 * pi) % 1.0
    side, inside = (1.0, turn) if turn < 0.5 else (-1.0, turn - 0.5)
    if inside >= 0.125:
        return side, 0.0
    return -side * cos(8.0 * pi * inside), 4.0 * side * sin(8.0 * pi * inside)


def faded(old: Point, new: Point, time: float) -> Point:
    """Return the point at `time` [s] into a cross-fade."""
    z = time / FADE
    if z >= 1.0:
        return new
    s, rate = 3.0 * z**2 - 2.0 * z**3, 6.0 * z * (1.0 - z) / FADE
    return old[0] + s * (new[0] - old[0]), (1.0 - s) * old[1] + s * new[1] + rate * (new[0] - old[0])


FLOOR_SHARE = 0.1
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


def floor(bench: Mapping[str, Any]) -> float:
    """Return g_min [N/s/A], from the bench at rest with p_a = alpha p_b, p_a + p_b = p_s and the spring relaxed."""
    alpha = bench["area_ratio"]
    pressure_b = bench["supply_pressure"] / (1.0 + alpha)
    return FLOOR_SHARE * _gain(bench, bench["spring_rest_position"], (alpha * pressure_b, pressure_b), 1.0)


def nominal_current(
    bench: Mapping[str, Any], values: Mapping[str, float], integral: float, force: str, scales: Sequence[float] = (1, 1)
) -> float:
    """Return u_nom [A] of one STATE, by field name, where `reference_force` and its rate are f_c and f_c'.

    `integral` is I [N/s], `force` the name of the followed force, `scales` are C_1 and C_2.
    """
    position = min(max(values["piston_position"], 0.0), bench["stroke"])
    volume_a, volume_b = _volumes(bench, position)
    stiffness = bench["bulk_modulus"] * bench["piston_area"] ** 2 * (1 / volume_a + bench["area_ratio"] ** 2 / volume_b)
    error = values["reference_force"] - values[force]
    wanted = values["reference_force_rate"] + values["proportional_gain"] * error + integral
    driven = wanted + scales[0] * stiffness * values["piston_velocity"]
    gain = scales[1] * _gain(bench, position, (values["pressure_a"], values["pressure_b"]), driven)
    return driven / max(gain, floor(bench))


def force_gain(bench: Mapping[str, Any]) -> float:
    """Return g [N/s/A] in the middle of the stroke, with half of the supply's pressure in both chambers."""
    return float(_gain(bench, bench["stroke"] / 2, (bench["supply_pressure"] / 2,) * 2, 1.0))


_VALUE, _RATE = STATE_FIELDS.index("reference_force"), STATE_FIELDS.index("reference_force_rate")
_ROUNDING = 1e-6
"""s: rounding of the clock decides whether a fade ends at its 300th or 301st sample."""


class Generator:
    """Expected f_r and f_r': `force` is the field of the force that the law follows, `fade` [s] its cross-fade."""

    def __init__(self, force: str, fade: float) -> None:
        self.force = STATE_FIELDS.index(force)
        self.fade = fade
        self.armed = False
        self.old: tuple[ReferenceSignal, float] = (ReferenceSignal(), 0.0)
        self.new: tuple[ReferenceSignal, float] = (ReferenceSignal(), 0.0)

    def point(self, state: State, wanted: ReferenceSignal, time: float) -> Point | None:
        """Return the expected point at this sample; None while the box is not armed."""
        if not state.flags & Flag.ARMED:
            self.armed = False
            return None
        if not self.armed:
            self.armed = True
            self.old, self.new = (ReferenceSignal(offset=state.values[self.force]), time), (wanted, time)
        elif time - self.new[1] >= self.fade and wanted != self.new[0]:
            self.old, self.new = self.new, (wanted, time)
        points = [shape(signal, time - begun) for signal, begun in (self.old, self.new)]
        return faded(points[0], points[1], time - self.new[1])


def playable(signal: ReferenceSignal, force_range: float) -> bool:
    """Return whether a box with this force range [N] must accept the reference."""
    numbers = (signal.amplitude, signal.offset, signal.phase, signal.frequency)
    if not all(abs(number) < 3.4e38 for number in numbers):  # NaN, too
        return False
    if signal.amplitude < 0.0 or signal.amplitude + abs(signal.offset) > force_range:
        return False
    return signal.waveform is Waveform.HOLD or 0.0 < signal.frequency < 1000.0


def compare(host: Host, force: str, tolerance: float, rate_tolerance: float) -> str:
    """Describe where the box's reference differs [N], [N/s]; empty if right with either rounding of the fade's end."""
    made = [Generator(force, FADE + rounding) for rounding in (-_ROUNDING, _ROUNDING)]
    found = [_compare(host, tolerance, rate_tolerance, generator) for generator in made]
    return "" if "" in found else found[0]


def _compare(host: Host, tolerance: float, rate_tolerance: float, generator: Generator) -> str:
    info: BoxInfo | None = host.hello.info if host.hello else None
    reach = host.details.details.force_range if host.details else 0.0
    commands, seen = {each.sequence: each.command for each in host.sent}, 0
    wanted = ReferenceSignal()
    assert info is not None
    for state in host.states:
        command = commands.get(state.last_command)
        if command is not None and playable(command.reference, reach or 1e6):
            wanted = command.reference
        point = generator.point(state, wanted, state.time_us * 1e-6)
        if point is None:
            continue
        seen += 1
        for name, index, right, allowed in (
            ("reference_force", _VALUE, point[0], tolerance),
            ("reference_force_rate", _RATE, point[1], rate_tolerance),
        ):
            if not abs(state.values[index] - right) <= allowed + 1e-4 * abs(right):
                return f"{name} is {state.values[index]:g} in STATE {state.sequence}, {right:g} is right"
    return "" if seen else "it was not armed"
