# SPDX-License-Identifier: Apache-2.0
"""Modulations of carriers: gates, hinges, places, levels and slow states."""

from __future__ import annotations

from collections.abc import Callable
from operator import attrgetter

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Modulation
from hydro_sim.model.grammar.words import PLACE, above, threshold
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Number

ALWAYS = Modulation(name="", text="{}", phrase="", factor=lambda at, n: 1.0)


TIMES = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""Start values [s] of slow states."""
_SHORT = (0.02, 0.1)


def _gate(name: str, text: str, phrase: str, uses: str, signal: str, side: float,
          direction: Callable[[Signals], Symbol]) -> Modulation:  # fmt: skip
    """1 where a signal has a sign, else 0; `direction`: that sign, rounded."""
    return Modulation(name=name, text=f"{{}} where {text}", phrase=phrase, uses=uses, gate=(signal, side),
                      factor=lambda at, n: np.fmax(side * direction(at), 0.0))  # fmt: skip


def _over(signal: str, turn: float) -> Callable[[Signals], Symbol]:
    """Sign of a signal, rounded over `turn` [SI unit]."""
    return lambda at: np.tanh(getattr(at, signal) / turn)


_MOVING = attrgetter("direction")
BY_MOTION = (
    _gate("outwards", "v > 0", ", only while the piston moves out", "velocity", "velocity", 1.0, _MOVING),
    _gate("inwards", "v < 0", ", only while the piston moves in", "velocity", "velocity", -1.0, _MOVING),
)
_ACROSS, _OPENED = _over("pressure_difference", 3e4), _over("current", 1e-5)
BY_PRESSURE = (
    _gate("driven out", "p_a > p_b", ", only while chamber A has the higher pressure: typical of a check valve or lip",
          "pressure_a pressure_b", "pressure_difference", 1.0, _ACROSS),
    _gate("driven in", "p_a < p_b", ", only while chamber B has the higher pressure: typical of a check valve or lip",
          "pressure_a pressure_b", "pressure_difference", -1.0, _ACROSS),
)  # fmt: skip
BY_SIDE = (
    _gate("to one side", "u > 0", ", only while the spool is opened one way", "current", "current", 1.0, _OPENED),
    _gate("to the other side", "u < 0", ", only while the spool is opened the other way", "current", "current",
          -1.0, _OPENED),
)  # fmt: skip
BY_EDGE = (
    Modulation(name="of the supply", text="{} at the supply", phrase=", at the edges to the supply",
               factor=lambda at, n: at.feeds),
    Modulation(name="of the return", text="{} at the return", phrase=", at the edges to the tank",
               factor=lambda at, n: 1.0 - at.feeds),
)  # fmt: skip


def _hinges(signal: str, symbol: str, name: str, unit: str, scale: float, uses: str,
            numbers: tuple[Number, ...]) -> tuple[Modulation, ...]:  # fmt: skip
    return (
        Modulation(name=f"above a {name}", text=f"{{}} max({symbol} - threshold, 0)", uses=uses, degree=1.0, unit=unit,
                   phrase=f", from a {name} on", factor=lambda at, n: above(getattr(at, signal), at.number),
                   scale=scale, numbers=numbers),
        Modulation(name=f"below a {name}", text=f"{{}} max(threshold - {symbol}, 0)", uses=uses, degree=1.0, unit=unit,
                   phrase=f", below a {name}", factor=lambda at, n: above(at.number, getattr(at, signal)),
                   scale=scale, numbers=numbers),
    )  # fmt: skip


BEYOND_PLACE = _hinges("position", "x", "place", "m", 1e-2, "position", PLACE)
BEYOND_SPEED = _hinges("speed", "|v|", "speed", "m/s", 0.05, "velocity",
                       threshold("speed", "m/s", 0.01, 0.03, 0.06, 0.1, 0.2))  # fmt: skip
BEYOND_PRESSURE = tuple(
    hinge
    for chamber in "ab"
    for hinge in _hinges(f"pressure_{chamber}", f"p_{chamber}", f"pressure of {chamber.upper()}", "Pa", 1e6,
                         f"pressure_{chamber}", threshold(f"pressure_{chamber}", "Pa", 3e6, 4e6, 5e6, 6e6, 8e6))
)  # fmt: skip
BEYOND_OPENING = (
    *_hinges("current", "u", "signed opening", "A", 2e-3, "current",
             threshold("current", "A", -3e-3, -1e-3, 1e-4, 1e-3, 3e-3)),
)  # fmt: skip

AT_PLACE = Modulation(
    name="at a place", text="{} exp(-((x - centre) / width)^2)", uses="position",
    phrase=", at one place of the stroke: typical of wear or a score where the cylinder works most",
    factor=lambda at, n: np.exp(-(((at.position - at.number) / at.second) ** 2)),
    numbers=(Number("centre", "m", PLACE[0].probes, "position"), Number("width", "m", (2e-3, 5e-3, 1.2e-2))),
)  # fmt: skip
LEVELLING = Modulation(
    name="levelling off", text="{} / (1 + |v| / level)", uses="velocity",
    phrase=" that levels off with speed: typical of oil that shears thin",
    factor=lambda at, n: 1.0 / (1.0 + at.speed / at.number), numbers=(Number("level", "m/s", (0.01, 0.03, 0.1)),),
)  # fmt: skip
FILM = Modulation(
    name="under a late film", text="{} exp(-(w / speed)^2), w' = (v - w) / time", uses="velocity",
    phrase=" that fades with speed, late: typical of a film that takes time to form",
    factor=lambda at, n: np.exp(-((at.memory / at.number) ** 2)), element=Element("slow", "velocity"),
    numbers=(Number("speed", "m/s", (0.01, 0.03, 0.1)), Number("time", "s", (0.01, 0.03, 0.1))),
)  # fmt: skip


def _slow(driver: str, symbol: str, name: str, unit: str, scale: float, uses: str, cause: str,
          times: tuple[float, ...] = TIMES) -> Modulation:  # fmt: skip
    """Grows with a state that follows a driver over a time, from 0: what work, motion or time alone has warmed."""
    return Modulation(
        name=f"as {name} warms", text=f"{{}} w, w' = ({symbol} - w) / time", unit=unit, scale=scale, uses=uses,
        phrase=f" that grows slowly with {cause}", factor=lambda at, n: at.memory, element=Element("slow", driver),
        numbers=(Number("time", "s", times),),
    )  # fmt: skip


BY_MOTION_PAST = _slow("speed", "|v|", "motion", "m/s", 0.05, "velocity",
                       "past motion: typical of seals, oil or grease that warm", (*_SHORT, *TIMES))  # fmt: skip
BY_THROTTLING = _slow("opening", "|u|", "throttling", "A", 1e-3, "current",
                      "the valve's past opening: typical of throttled oil that warms")  # fmt: skip
BY_HEATING = _slow("heating", "u^2", "the coil", "A2", 1e-6, "current",
                   "the square of past current: typical of a coil that warms")  # fmt: skip
BY_LOADING = _slow("size_of_difference", "|p_a - p_b|", "pressure", "Pa", 1e6, "pressure_a pressure_b",
                   "past pressure: typical of parts that give slowly")  # fmt: skip
BY_TIME = Modulation(
    name="from the start", text="{} (1 - exp(-t / time))", uses="time",
    phrase=" that settles from the start of a recording: typical of what warms after it is switched on",
    factor=lambda at, n: at.memory, element=Element("slow", "time"), numbers=(Number("time", "s", TIMES),),
)  # fmt: skip
