# SPDX-License-Identifier: Apache-2.0
"""Carriers: the quantities that terms of each equation are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Carrier
from hydro_sim.model.grammar.words import deflection
from hydro_sim.model.laws import Number, Signals

_FRICTION = "Dry friction"


def _force(name: str, unit: str, text: str, phrase: str, scale: float, uses: str, degree: float,
           shape: Callable[[Signals, Any], Symbol], equation: str = "motion") -> Carrier:  # fmt: skip
    return Carrier(equation=equation, name=name, unit=unit, text=text, phrase=phrase, size=5.0, scale=scale, uses=uses,
                   degree=degree, shape=shape)  # fmt: skip


CONSTANT_FORCE = _force(
    "force", "-", "1", "A force against the motion", 1.0, "", 0.0, lambda at, n: 1.0 + 0.0 * at.position
)
DRY = _force("friction", "-", "sign(v)", _FRICTION, 1.0, "velocity", 0.0, lambda at, n: at.direction)
VISCOUS = _force("drag", "m/s", "v", "Viscous friction", 0.05, "velocity", 1.0, lambda at, n: at.velocity)
SQUARE = _force(
    "quadratic drag",
    "m2/s2",
    "v |v|",
    "A force against motion that grows with the square of speed",
    2.5e-3,
    "velocity",
    2.0,
    lambda at, n: at.velocity * np.abs(at.velocity),
)
ROOT = _force(
    "root drag",
    "sqrt(m/s)",
    "sign(v) sqrt(|v|)",
    "A force against motion that grows with the root of speed",
    0.2,
    "velocity",
    0.5,
    lambda at, n: at.velocity / np.sqrt(np.abs(at.velocity) + at.turn),
)
BY_PRESSURE = tuple(
    _force(f"friction by pressure of {chamber.upper()}", "Pa", f"sign(v) p_{chamber}",
           f"Dry friction by the pressure of chamber {chamber.upper()}", 5e6, f"pressure_{chamber} velocity", 1.0,
           shape)
    for chamber, shape in (("a", lambda at, n: at.direction * at.pressure_a),
                           ("b", lambda at, n: at.direction * at.pressure_b))
)  # fmt: skip
BY_DIFFERENCE = _force("friction by pressure difference", "Pa", "sign(v) |p_a - p_b|",
                       "Dry friction by the pressure across the piston", 3e6, "pressure_a pressure_b velocity", 1.0,
                       lambda at, n: at.direction * np.abs(at.pressure_difference))  # fmt: skip

LOAD_DRY = _force(
    "rubbing",
    "-",
    "sign(v)",
    "Dry friction in the load's way",
    1.0,
    "velocity",
    0.0,
    lambda at, n: at.direction,
    "load",
)
LOAD_VISCOUS = _force(
    "damping", "m/s", "v", "Damping in the load's way", 0.05, "velocity", 1.0, lambda at, n: at.velocity, "load"
)
LOAD_SQUARE = _force(
    "quadratic damping",
    "m2/s2",
    "v |v|",
    "Damping in the load's way, with the square of speed",
    2.5e-3,
    "velocity",
    2.0,
    lambda at, n: at.velocity * np.abs(at.velocity),
    "load",
)
LOAD_RUBBING = _force(
    "rubbing by deflection",
    "m",
    "sign(v) |x - x_rest|",
    "Friction in the load that grows as it is bent: typical of a leaf spring",
    1e-2,
    "position velocity",
    1.0,
    lambda at, n: at.direction * np.abs(deflection(at, n)),
    "load",
)
LOAD_SPRING = _force(
    "stiffness", "m", "(x - x_rest)", "A stiffness of the load", 1e-2, "position", 1.0, deflection, "load"
)
LOAD_INERTIA = _force(
    "inertia", "m/s2", "x''", "A mass that the load drags along", 5.0, "acceleration", 1.0,
    lambda at, n: at.acceleration, "load",
)  # fmt: skip
STIFFNESS = _force("stiffness", "m", "(x - x_rest)", "A stiffness beside the load", 1e-2, "position", 1.0, deflection)
LOAD_CONSTANT = _force(
    "load", "-", "1", "A force of the load", 1.0, "", 0.0, lambda at, n: 1.0 + 0.0 * at.position, "load"
)


def _flow(equation: str, name: str, unit: str, text: str, phrase: str, scale: float, uses: str, degree: float,
          shape: Callable[[Signals, Any], Symbol]) -> Carrier:  # fmt: skip
    return Carrier(equation=equation, name=name, unit=unit, text=text, phrase=phrase, size=3e-7, scale=scale,
                   uses=uses, degree=degree, shape=shape)  # fmt: skip


def _root(pressure: Symbol) -> Symbol:
    return pressure / np.sqrt(np.abs(pressure) + 100.0)


_BETWEEN = "pressure_a pressure_b"
LEAK = _flow(
    "pressure",
    "leak",
    "Pa",
    "(p_a - p_b)",
    "A leak between the chambers",
    3e6,
    _BETWEEN,
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
    _BETWEEN,
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
        _flow(equation, "carried oil", "m3/s", f"v A_{chamber}", f"Oil of chamber {big} that the motion carries along",
              5e-6, "velocity", 1.0, lambda at, n: at.velocity * area(n)),
    )  # fmt: skip


CHAMBERS = (
    *_of_chamber("a", lambda at: at.pressure_a, lambda n: n.piston_area),
    *_of_chamber("b", lambda at: at.pressure_b, lambda n: n.area_ratio * n.piston_area),
)


def _edges_of(chamber: str, pressure: Callable[[Signals], Symbol], side: float) -> tuple[Carrier, ...]:
    """Shares of the flow through one edge of four that do not pass, and leaks from the supply; out of the chamber."""
    equation, big = f"pressure_{chamber}", chamber.upper()
    fed, drained = ("u", "-u") if side > 0.0 else ("-u", "u")

    def opened(at: Signals, n: Any, to: float) -> Symbol:
        return n.valve_gain * np.fmax(to * side * at.current, 0.0)

    return (
        _flow(equation, "flow of the supply's edge", "m3/s", f"K max({fed}, 0) sqrt(p_s - p_{chamber})",
              f"The edge from the supply to chamber {big} passes less than the others: typical of one that is silted "
              "up or worn", 5e-6, f"current {equation}", 1.5,
              lambda at, n: opened(at, n, 1.0) * _root(n.supply_pressure - pressure(at))),
        _flow(equation, "flow of the tank's edge", "m3/s", f"-K max({drained}, 0) sqrt(p_{chamber} - p_t)",
              f"The edge from chamber {big} to the tank passes less than the others: typical of one that is silted "
              "up or worn", 5e-6, f"current {equation}", 1.5,
              lambda at, n: -opened(at, n, -1.0) * _root(pressure(at) - n.tank_pressure)),
        _flow(equation, "leak from the supply", "Pa", f"-(p_s - p_{chamber})",
              f"A leak from the supply into chamber {big}", 5e6, equation, 1.0,
              lambda at, n: pressure(at) - n.supply_pressure),
        _flow(equation, "hole to the supply", "sqrt(Pa)", f"-sqrt(p_s - p_{chamber})",
              f"A leak through a hole from the supply into chamber {big}", 2e3, equation, 0.5,
              lambda at, n: -_root(n.supply_pressure - pressure(at))),
    )  # fmt: skip


FED = (*_edges_of("a", lambda at: at.pressure_a, 1.0), *_edges_of("b", lambda at: at.pressure_b, -1.0))


def _spool(name: str, unit: str, text: str, phrase: str, scale: float, uses: str, degree: float,
           shape: Callable[[Signals, Any], Symbol]) -> Carrier:  # fmt: skip
    return Carrier(equation="actuation", name=name, unit=unit, text=text, phrase=phrase, size=1e-4, scale=scale,
                   uses=uses, degree=degree, shape=shape)  # fmt: skip


NULL = _spool("null", "-", "1", "A shift of the valve's null", 1.0, "", 0.0, lambda at, n: 1.0 + 0.0 * at.current)
GAIN = _spool("gain", "A", "u", "A gain of the valve", 2e-3, "current", 1.0, lambda at, n: at.current)
CURVE = _spool(
    "curve",
    "A2",
    "u |u|",
    "A gain of the valve that changes with its opening",
    4e-6,
    "current",
    2.0,
    lambda at, n: at.current * np.abs(at.current),
)


def _edge(name: str, text: str, phrase: str, scale: float, unit: str, degree: float,
          shape: Callable[[Signals, Any], Symbol], numbers: tuple[Number, ...] = (),
          size: float = 1.0) -> Carrier:  # fmt: skip
    return Carrier(
        equation="actuation",
        name=name,
        unit=unit,
        text=text,
        phrase=phrase,
        size=size,
        scale=scale,
        uses="current pressure_a pressure_b",
        degree=degree,
        shape=shape,
        where="edges",
        numbers=numbers,
    )


THROTTLE = _edge(
    "throttled flow",
    "q (1 - 1 / sqrt(1 + resistance K^2))",
    "Flow through a throttle behind or before the edges, whose pressure drop grows with q^2: typical of a clogged "
    "filter or a narrow line; 1: all of it",
    1.0,
    "-",
    3.0,
    lambda at, n: 1.0 - 1.0 / np.sqrt(1.0 + at.number * at.opened * at.opened),
    (Number("resistance", "Pa s2/m6", (1e14, 5e14, 2e15, 1e16)),),
)
NARROWED = _edge(
    "narrowed flow",
    "q",
    "Edges that pass less than their share",
    1.0,
    "-",
    1.5,
    lambda at, n: 1.0 + 0.0 * at.drop,
    size=0.05,
)


def _pressed(name: str, unit: str, text: str, cause: str, scale: float, uses: str, degree: float,
             shape: Callable[[Signals, Any], Symbol]) -> Carrier:  # fmt: skip
    return Carrier(equation="actuation", name=f"null by {name}", unit=unit, text=text,
                   phrase=f"The valve's null moves with {cause}", size=5e-5, scale=scale, uses=uses, degree=degree,
                   shape=shape, where="across")  # fmt: skip


PRESSED = (
    _pressed("pressure difference", "Pa", "(p_a - p_b)", "the pressure across the load: typical of a spool that it "
             "leans on", 3e6, _BETWEEN, 1.0, lambda at, n: at.pressure_difference),
    _pressed("pressure of A", "Pa", "p_a", "the pressure of chamber A: typical of a housing that it strains", 5e6,
             "pressure_a", 1.0, lambda at, n: at.pressure_a),
    _pressed("pressure of B", "Pa", "p_b", "the pressure of chamber B: typical of a housing that it strains", 5e6,
             "pressure_b", 1.0, lambda at, n: at.pressure_b),
    _pressed("velocity", "m/s", "v", "the velocity: typical of a feedback that follows the piston", 0.05, "velocity",
             1.0, lambda at, n: at.velocity),
    _pressed("position", "m", "(x - x_rest)", "the position: typical of a feedback that follows the piston", 1e-2,
             "position", 1.0, deflection),
    _pressed("opening and load", "A Pa", "u (p_a - p_b)", "its opening times the pressure across the load: typical of "
             "flow forces", 6e3, f"current {_BETWEEN}", 2.0, lambda at, n: at.current * at.pressure_difference),
)  # fmt: skip
JETS = _edge("flow under jets", "q dp_o / (dp_o + level)", "Edges that pass less the larger the pressure drop dp_o "
             "over both that are open: typical of jets that close the spool against its spring; 1: all of it", 1.0,
             "-", 2.5, lambda at, n: np.abs(at.both) / (np.abs(at.both) + at.number),
             (Number("level", "Pa", (1e7, 3e7, 1e8, 3e8)),))  # fmt: skip
