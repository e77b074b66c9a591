# SPDX-License-Identifier: Apache-2.0
"""Carriers of the valve: what terms of the spool, its edges and its null are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Carrier
from hydro_sim.model.grammar.words import BETWEEN, deflection
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Number


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
             "leans on", 3e6, BETWEEN, 1.0, lambda at, n: at.pressure_difference),
    _pressed("pressure of A", "Pa", "p_a", "the pressure of chamber A: typical of a housing that it strains", 5e6,
             "pressure_a", 1.0, lambda at, n: at.pressure_a),
    _pressed("pressure of B", "Pa", "p_b", "the pressure of chamber B: typical of a housing that it strains", 5e6,
             "pressure_b", 1.0, lambda at, n: at.pressure_b),
    _pressed("velocity", "m/s", "v", "the velocity: typical of a feedback that follows the piston", 0.05, "velocity",
             1.0, lambda at, n: at.velocity),
    _pressed("position", "m", "(x - x_rest)", "the position: typical of a feedback that follows the piston", 1e-2,
             "position", 1.0, deflection),
    _pressed("opening and pressure of A", "A Pa", "u p_a", "its opening times the pressure of chamber A: typical of "
             "flow forces on one land", 1e4, "current pressure_a", 2.0, lambda at, n: at.current * at.pressure_a),
    _pressed("opening and pressure of B", "A Pa", "u p_b", "its opening times the pressure of chamber B: typical of "
             "flow forces on one land", 1e4, "current pressure_b", 2.0, lambda at, n: at.current * at.pressure_b),
    _pressed("opening and size of load", "A Pa", "u |p_a - p_b|", "its opening times the size of the pressure across "
             "the load: typical of a spool that pressure bends or clamps", 6e3, f"current {BETWEEN}", 2.0,
             lambda at, n: at.current * at.size_of_difference),
    _pressed("opening and speed", "A m/s", "u |v|", "its opening times the speed", 1e-4, "current velocity", 2.0,
             lambda at, n: at.current * at.speed),
    _pressed("opening and position", "A m", "u (x - x_rest)", "its opening times the position: typical of a feedback "
             "that follows the piston", 2e-5, "current position", 2.0, lambda at, n: at.current * deflection(at, n)),
    _pressed("opening and load", "A Pa", "u (p_a - p_b)", "its opening times the pressure across the load: typical of "
             "flow forces", 6e3, f"current {BETWEEN}", 2.0, lambda at, n: at.current * at.pressure_difference),
)  # fmt: skip
JETS = _edge("flow under jets", "q dp_o / (dp_o + level)", "Edges that pass less the larger the pressure drop dp_o "
             "over both that are open: typical of jets that close the spool against its spring; 1: all of it", 1.0,
             "-", 2.5, lambda at, n: np.abs(at.both) / (np.abs(at.both) + at.number),
             (Number("level", "Pa", (1e7, 3e7, 1e8, 3e8)),))  # fmt: skip
CHOKED = _edge("choked flow", "q max(1 - sqrt(choked / dp), 0)", "Edges that pass no more beyond a pressure drop dp: "
               "typical of oil that cavitates in its jet; 1: all of it", 1.0, "-", 1.5,
               lambda at, n: np.fmax(1.0 - np.sqrt(at.number / np.fmax(np.abs(at.drop), at.number)), 0.0),
               (Number("choked", "Pa", (1e6, 2e6, 4e6, 8e6)),))  # fmt: skip
