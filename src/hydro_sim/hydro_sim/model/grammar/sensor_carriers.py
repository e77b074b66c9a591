# SPDX-License-Identifier: Apache-2.0
"""Carriers of the sensors: what a reading picks up beside its signal, its zero and gain, and the reading itself."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Carrier
from hydro_sim.model.grammar.words import deflection
from hydro_sim.model.law_signals import Signals

_SENSORS = {"hydraulic_force": "load cell at the piston rod", "load_force": "load cell at the load",
            "pressure_a": "pressure sensor of chamber A", "pressure_b": "pressure sensor of chamber B",
            "piston_position": "position sensor"}  # fmt: skip
_BESIDE = (
    ("current", "u", "A", 3e-3, "the valve's current: typical of cables side by side"),
    ("position", "x", "m", 2e-2, "the position: typical of a cable or a mount that is bent"),
    ("velocity", "v", "m/s", 0.05, "the velocity: typical of a hose or a mount that is dragged along"),
    ("acceleration", "x''", "m/s2", 5.0, "the acceleration: typical of a body of its own that is shaken"),
    ("pressure_a", "p_a", "Pa", 5e6, "the pressure of chamber A: typical of a housing that pressure strains"),
    ("pressure_b", "p_b", "Pa", 5e6, "the pressure of chamber B: typical of a housing that pressure strains"),
    ("opening", "|u|", "A", 3e-3, "the size of the valve's current: typical of a supply that sags under it"),
    ("heating", "u^2", "A2", 1e-5, "the square of the valve's current: typical of an amplifier that rectifies"),
    ("speed", "|v|", "m/s", 0.05, "the speed: typical of a line in which oil flows past it"),
    ("jet", "v |v|", "m2/s2", 2.5e-3, "the square of the velocity: typical of a line in which oil flows past it"),
)
_MADE_OF = {"opening": "current", "heating": "current", "speed": "velocity", "jet": "velocity"}
"""Signals of which others are made."""


def _of_sensor(channel: str) -> tuple[tuple[Carrier, ...], tuple[Carrier, ...]]:
    place = channel == "piston_position"
    own, size = ("Pa", 5e4) if channel.startswith("pressure") else ("m", 1e-5) if place else ("N", 5.0)
    itself = channel if channel.startswith("pressure") else "position" if place else "force"
    symbol = {"hydraulic_force": "f_h", "load_force": "f_l", "piston_position": "x"}.get(channel, f"p_{channel[-1]}")
    signals, typical = ("position", 4e-2) if place else (channel, 100.0 * size)

    def made(name: str, unit: str, text: str, phrase: str, scale: float, uses: str, degree: float,
             shape: Callable[[Signals, Any], Symbol]) -> Carrier:  # fmt: skip
        return Carrier(equation="sensor", name=f"{name} of {channel}", unit=unit, text=text, phrase=phrase, size=size,
                       scale=scale, uses=uses, degree=degree, shape=shape, where=channel)  # fmt: skip

    def beside(signal: str, text: str, unit: str, scale: float, cause: str) -> Carrier:
        return made(f"pick-up of {signal}", unit, text, f"The {_SENSORS[channel]} also reads {cause}", scale,
                    _MADE_OF.get(signal, signal), 2.0 if signal in ("jet", "heating") else 1.0,
                    lambda at, n: getattr(at, signal))  # fmt: skip

    picked = tuple(beside(*one) for one in _BESIDE if one[0] not in (channel, itself)
                   and not (place and one[0] == "acceleration"))  # fmt: skip
    zero = made(
        "zero",
        "-",
        "1",
        f"A zero of the {_SENSORS[channel]}",
        1.0,
        "",
        0.0,
        lambda at, n: 1.0 + 0.0 * getattr(at, itself),
    )
    gain = made("gain", own, symbol, f"A gain of the {_SENSORS[channel]}", typical, signals, 1.0,
                lambda at, n: getattr(at, itself))  # fmt: skip
    return picked, (zero, gain)


PICKED = tuple(carrier for channel in _SENSORS for carrier in _of_sensor(channel)[0])
DRIFTING = tuple(carrier for channel in _SENSORS for carrier in _of_sensor(channel)[1])
BENT_BY_LOAD = Carrier(
    equation="sensor", name="pick-up of deflection of piston_position", unit="m", text="(x - x_rest)",
    phrase="The position sensor also reads the load's deflection: typical of a bracket that bends under the load",
    size=1e-5, scale=1e-2, uses="position", degree=1.0, shape=deflection, where="piston_position",
)  # fmt: skip
GAINS_OF = {channel: _of_sensor(channel)[1][1] for channel in _SENSORS if channel != "piston_position"}
GAINS = tuple(GAINS_OF.values())
READ = {
    channel: replace(_of_sensor(channel)[1][0], name=f"reading of {channel}", phrase=f"The {words} reads otherwise")
    for channel, words in _SENSORS.items()
}
"""By channel: 1, which a modulation by its own signal makes a law of its reading."""
