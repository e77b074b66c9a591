# SPDX-License-Identifier: Apache-2.0
"""Grammar of closures: the laws and tables that are tried where no named effect explains the residual."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.laws import SIGN_VELOCITY, Element, Factor, Law, Signals, Table


def _sign(velocity: Symbol) -> Symbol:
    return np.tanh(velocity / SIGN_VELOCITY)


def _middle(at: Signals, n: Any) -> Symbol:
    """Position from the middle of the stroke, in strokes."""
    return at.position / n.stroke - 0.5


def _deflection(at: Signals, n: Any) -> Symbol:
    return at.position - n.spring_rest_position


def _creep(signal: str) -> Element:
    return Element("lag", signal, "time", "s", (0.03, 0.1, 0.3, 1.0, 3.0))


_LAMINAR = "a gap whose width changes along the stroke: a bore that is worn or a tube that widens"
LAWS: tuple[Law, ...] = (
    Law("motion", "quadratic drag", "N s2/m2", "v |v|",
        "Force against motion that grows with the square of speed: typical of oil forced through a port.",
        100.0, lambda at, n: at.velocity * np.abs(at.velocity)),
    Law("motion", "cubic drag", "N s3/m3", "v^3",
        "Force against motion that grows with the cube of speed: typical of a choked port.",
        1000.0, lambda at, n: at.velocity * at.velocity * at.velocity),
    Law("motion", "root drag", "N sqrt(s/m)", "sign(v) sqrt(|v|)",
        "Force against motion that levels off with speed: typical of seals whose oil film grows.",
        10.0, lambda at, n: at.velocity / np.sqrt(np.abs(at.velocity) + SIGN_VELOCITY)),
    Law("motion", "friction along the stroke", "N", "sign(v) (x/L - 1/2)",
        "Dry friction that changes along the stroke: typical of a rod that is bent or a bore that is worn.",
        20.0, lambda at, n: _sign(at.velocity) * _middle(at, n)),
    Law("motion", "drag along the stroke", "N s/m", "v (x/L - 1/2)",
        "Viscous friction that changes along the stroke: typical of a gap that is not even.",
        100.0, lambda at, n: at.velocity * _middle(at, n)),
    Law("motion", "drag off the middle", "N s/m", "v (x/L - 1/2)^2",
        "Viscous friction that grows to either side of the middle: typical of a bore that narrows towards its ends.",
        500.0, lambda at, n: at.velocity * _middle(at, n) * _middle(at, n)),
    Law("motion", "friction by pressure", "N/Pa", "sign(v) (p_a + p_b)/2",
        "Dry friction that grows with pressure: typical of seals that pressure presses on.",
        1e-6, lambda at, n: _sign(at.velocity) * 0.5 * (at.pressure_a + at.pressure_b)),
    Law("motion", "friction by pressure difference", "N/Pa", "sign(v) |p_a - p_b|",
        "Dry friction that grows with the pressure across the piston: typical of a piston seal.",
        1e-6, lambda at, n: _sign(at.velocity) * np.abs(at.pressure_difference)),
    Law("pressure", "leak along the stroke", "m3/s/Pa", "(p_a - p_b) (x/L - 1/2)",
        f"A leak between the chambers that changes along the stroke: typical of {_LAMINAR}.",
        1e-13, lambda at, n: at.pressure_difference * _middle(at, n)),
    Law("pressure", "quadratic leak", "m3/s/Pa2", "(p_a - p_b) |p_a - p_b|",
        "A leak between the chambers that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_difference * np.abs(at.pressure_difference)),
    Law("pressure_a", "creeping volume", "m3/s/Pa", "(p_a - w), w' = (p_a - w) / time",
        "Chamber A goes on taking oil after its pressure has risen: typical of a hose that creeps.",
        1e-13, lambda at, n: at.pressure_a - at.memory, _creep("pressure_a")),
    Law("pressure_b", "creeping volume", "m3/s/Pa", "(p_b - w), w' = (p_b - w) / time",
        "Chamber B goes on taking oil after its pressure has risen: typical of a hose that creeps.",
        1e-13, lambda at, n: at.pressure_b - at.memory, _creep("pressure_b")),
    Law("pressure_a", "quadratic leak", "m3/s/Pa2", "p_a^2",
        "A leak of chamber A that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_a * at.pressure_a),
    Law("pressure_b", "quadratic leak", "m3/s/Pa2", "p_b^2",
        "A leak of chamber B that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_b * at.pressure_b),
    Law("actuation", "quadratic gain", "1/A", "u |u|",
        "Flow that is not proportional to the current: typical of edges with round ports.",
        1.0, lambda at, n: at.current * np.abs(at.current)),
    Law("actuation", "cubic gain", "1/A2", "u^3",
        "Flow that saturates or grows with the current: typical of a torque motor near its limit.",
        100.0, lambda at, n: at.current * at.current * at.current),
    Law("actuation", "hysteresis", "A", "w, w' = (u' - |u'| w) / path",
        "Flow that follows another path up than down: typical of a torque motor whose iron stays magnetic.",
        2e-4, lambda at, n: at.memory, Element("path", "current", "path", "A", (1e-4, 3e-4, 1e-3, 3e-3))),
    Law("load", "quadratic spring", "N/m2", "(x - x_rest) |x - x_rest|",
        "Load whose stiffness changes with its deflection: typical of a contact that grows.",
        1e5, lambda at, n: _deflection(at, n) * np.abs(_deflection(at, n))),
    Law("load", "lopsided spring", "N/m", "|x - x_rest|",
        "Load that is stiffer on one side of its rest: typical of a second spring or a preload that opens.",
        100.0, lambda at, n: np.abs(_deflection(at, n))),
    Law("load", "hysteresis", "N", "w, w' = (v - |v| w) / path",
        "Load that follows another path back than forth: typical of rubber, a leaf spring or a joint that rubs.",
        5.0, lambda at, n: at.memory, Element("path", "position", "path", "m", (3e-4, 1e-3, 3e-3, 1e-2))),
    Law("load", "creeping spring", "N/m", "(x - w), w' = (x - w) / time",
        "Load that relaxes where it is held: typical of rubber or plastic in the load's way.",
        1e3, lambda at, n: at.position - at.memory, _creep("position")),
    Law("sensor", "creep of the cell at the rod", "-", "w, w' = (f_h - w) / time",
        "The load cell at the piston rod goes on rising under a force that stays: typical of a glued strain gauge.",
        0.05, lambda at, n: at.memory, _creep("force")),
)  # fmt: skip
"""Laws that are tried."""

_VELOCITY = Factor("velocity", "v", lambda at: at.velocity)
_DIRECTION = Factor("direction", "sign(v)", lambda at: _sign(at.velocity))
_ACROSS = Factor("pressure difference", "(p_a - p_b)", lambda at: at.pressure_difference)

TABLES: tuple[Table, ...] = (
    Table("motion", "velocity", "N", 5.0), Table("motion", "position", "N", 5.0), Table("load", "position", "N", 5.0),
    Table("pressure", "pressure_difference", "m3/s", 1e-7), Table("pressure", "position", "m3/s", 1e-7),
    Table("actuation", "current", "A", 1e-4),
    Table("motion", "position", "N s/m", 20.0, _VELOCITY), Table("motion", "position", "N", 5.0, _DIRECTION),
    Table("motion", "pressure_difference", "N", 5.0, _DIRECTION),
    Table("pressure", "position", "m3/s/Pa", 1e-13, _ACROSS),
)  # fmt: skip
"""Smooth functions that are tried where no law is found: of each variable, and what laws of two variables vary with."""

_EVERY: tuple[Law | Table, ...] = (*LAWS, *TABLES)
ALL: dict[tuple[str, str], Law | Table] = {(one.equation, one.form): one for one in _EVERY}
"""By equation and form."""


def remembers(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` has hidden states."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return isinstance(law, Law) and law.element is not None
