# SPDX-License-Identifier: Apache-2.0
"""Carriers of forces: what terms of the motion and of the load are made of."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Carrier
from hydro_sim.model.grammar.words import deflection
from hydro_sim.model.law_signals import Signals

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
BENDING = _force("bending", "m", "|x - x_rest|", "A force of the load by its deflection", 1e-2, "position", 1.0,
                 lambda at, n: np.abs(deflection(at, n)), "load")  # fmt: skip
PRESSING = tuple(
    _force(f"pressing by {name}", "Pa", text, f"A force by {words}", 5e6, uses, 1.0, shape)
    for name, text, words, uses, shape in (
        ("A", "p_a", "the pressure of chamber A", "pressure_a", lambda at, n: at.pressure_a),
        ("B", "p_b", "the pressure of chamber B", "pressure_b", lambda at, n: at.pressure_b),
        ("difference", "|p_a - p_b|", "the pressure across the piston", "pressure_a pressure_b",
         lambda at, n: at.size_of_difference))
)  # fmt: skip
"""Of what presliding makes friction."""
