# SPDX-License-Identifier: Apache-2.0
"""Carriers of flows: what terms of the chambers' pressures are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Carrier
from hydro_sim.model.grammar.words import BETWEEN
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Number

_TURNED = 1e-5
"""Current [A] over which one edge of a port takes over from the other."""


def _flow(equation: str, name: str, unit: str, text: str, phrase: str, scale: float, uses: str, degree: float,
          shape: Callable[[Signals, Any], Symbol], numbers: tuple[Number, ...] = ()) -> Carrier:  # fmt: skip
    return Carrier(equation=equation, name=name, unit=unit, text=text, phrase=phrase, size=3e-7, scale=scale,
                   uses=uses, degree=degree, shape=shape, numbers=numbers)  # fmt: skip


def _root(pressure: Symbol) -> Symbol:
    return pressure / np.sqrt(np.abs(pressure) + 100.0)


LEAK = _flow(
    "pressure",
    "leak",
    "Pa",
    "(p_a - p_b)",
    "A leak between the chambers",
    3e6,
    BETWEEN,
    1.0,
    lambda at, n: at.pressure_difference,
)
HOLE = _flow(
    "pressure",
    "hole",
    "sqrt(Pa)",
    "sqrt(p_a - p_b)",
    "A leak through a hole between the chambers",
    2e3,
    BETWEEN,
    0.5,
    lambda at, n: _root(at.pressure_difference),
)


def _of_chamber(
    chamber: str, pressure: Callable[[Signals], Symbol], area: Callable[[Any], Symbol]
) -> tuple[Carrier, ...]:
    equation, big = f"pressure_{chamber}", chamber.upper()
    return (
        _flow(equation, "leak", "Pa", f"p_{chamber}", f"A leak of chamber {big} to the outside", 5e6, equation, 1.0,
              lambda at, n: pressure(at)),
        _flow(equation, "hole", "sqrt(Pa)", f"sqrt(p_{chamber})", f"A leak of chamber {big} through a hole", 2e3,
              equation, 0.5, lambda at, n: _root(pressure(at))),
        _flow(equation, "flow", "-", "1", f"A flow out of chamber {big}", 1.0, "", 0.0,
              lambda at, n: 1.0 + 0.0 * pressure(at)),
        _flow(equation, "carried oil", "m3/s", f"v A_{chamber}", f"Oil of chamber {big} that the motion carries along",
              5e-6, "velocity", 1.0, lambda at, n: at.velocity * area(n)),
    )  # fmt: skip


_BESIDE = (
    *_of_chamber("a", lambda at: at.pressure_a, lambda n: n.piston_area),
    *_of_chamber("b", lambda at: at.pressure_b, lambda n: n.area_ratio * n.piston_area),
)
CONSTANT = tuple(one for one in _BESIDE if one.text == "1")
CHAMBERS = tuple(one for one in _BESIDE if one not in CONSTANT)
CARRIED = tuple(one for one in CHAMBERS if one.uses == "velocity")


def _edges_of(chamber: str, pressure: Callable[[Signals], Symbol], side: float) -> tuple[Carrier, ...]:
    """Shares of the flow through one edge of four that do not pass, and leaks from the supply; out of the chamber."""
    equation, big = f"pressure_{chamber}", chamber.upper()
    fed, drained = ("u", "-u") if side > 0.0 else ("-u", "u")

    def opened(at: Signals, n: Any, to: float) -> Symbol:
        return n.valve_gain * np.fmax(to * side * at.current, 0.0)

    def of_supply(at: Signals, n: Any) -> Symbol:
        return _root(n.supply_pressure - pressure(at))

    def of_tank(at: Signals, n: Any) -> Symbol:
        return _root(pressure(at) - n.tank_pressure)

    def supplied(at: Signals, n: Any) -> Symbol:
        return opened(at, n, 1.0) * of_supply(at, n)

    def returned(at: Signals, n: Any) -> Symbol:
        return -opened(at, n, -1.0) * of_tank(at, n)

    def throttled(at: Signals, n: Any) -> Symbol:
        opening = n.valve_gain * at.current
        return (supplied(at, n) + returned(at, n)) * (1.0 - 1.0 / np.sqrt(1.0 + at.number * opening * opening))

    def shifted(at: Signals, n: Any) -> Symbol:
        feeds = 0.5 + 0.5 * np.tanh(side * at.current / _TURNED)
        return -n.valve_gain * (feeds * of_supply(at, n) + (1.0 - feeds) * of_tank(at, n))

    return (
        _flow(equation, "flow of the supply's edge", "m3/s", f"K max({fed}, 0) sqrt(p_s - p_{chamber})",
              f"The edge from the supply to chamber {big} passes less than the others: typical of one that is silted "
              "up or worn", 5e-6, f"current {equation}", 1.5, supplied),
        _flow(equation, "flow of the tank's edge", "m3/s", f"-K max({drained}, 0) sqrt(p_{chamber} - p_t)",
              f"The edge from chamber {big} to the tank passes less than the others: typical of one that is silted "
              "up or worn", 5e-6, f"current {equation}", 1.5, returned),
        _flow(equation, "flow of the port", "m3/s", f"q_{chamber}",
              f"Chamber {big} gets less of the valve's flow q_{chamber} than its edges pass: typical of a port that "
              "the piston covers", 5e-6, f"current {equation}", 1.5,
              lambda at, n: supplied(at, n) + returned(at, n)),
        _flow(equation, "throttled flow of the port", "m3/s", f"q_{chamber} (1 - 1 / sqrt(1 + resistance K^2))",
              f"Flow q_{chamber} of the valve through a throttle before chamber {big}, whose pressure drop grows with "
              "q^2: typical of a narrow line or port; 1: all of it", 5e-6, f"current {equation}", 1.5, throttled,
              (Number("resistance", "Pa s2/m6", (1e14, 5e14, 2e15, 1e16)),)),
        _flow(equation, "null of the port", "m3/s/A", f"-K sqrt(dp_{chamber})",
              f"The edges of chamber {big} see a current that is shifted: typical of lands that are ground apart",
              2e-3, f"current {equation}", 0.5, shifted),
        _flow(equation, "leak from the supply", "Pa", f"-(p_s - p_{chamber})",
              f"A leak from the supply into chamber {big}", 5e6, equation, 1.0,
              lambda at, n: pressure(at) - n.supply_pressure),
        _flow(equation, "hole to the supply", "sqrt(Pa)", f"-sqrt(p_s - p_{chamber})",
              f"A leak through a hole from the supply into chamber {big}", 2e3, equation, 0.5,
              lambda at, n: -_root(n.supply_pressure - pressure(at))),
    )  # fmt: skip


_EDGES = (*_edges_of("a", lambda at: at.pressure_a, 1.0), *_edges_of("b", lambda at: at.pressure_b, -1.0))
PORTS = tuple(one for one in _EDGES if one.name == "flow of the port")
FED = tuple(
    one for one in _EDGES if one.name in ("leak from the supply", "hole to the supply") or "'s edge" in one.name
)
OF_PORT = tuple(one for one in _EDGES if one not in (*PORTS, *FED))
