# SPDX-License-Identifier: Apache-2.0
"""Laws of physics that has no name in the table: terms of the bench's equations, written once for arrays and symbols.

A law is linear in its numbers. What it gives acts in one equation::

    motion      force [N] against the motion
    pressure    flow [m3/s] out of chamber A into chamber B
    pressure_a  flow [m3/s] out of chamber A to the tank; pressure_b likewise
    actuation   spool position [A] that the edges see more than the current says
    load        force [N] of the load

None hangs on time: such a law would grow for ever. A table is a law too: a cubic spline with equally spaced knots,
constant beyond the range that was seen.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol, clip

KNOTS = 12
"""Numbers of a table: of so many cubic B-splines."""
SIGN_VELOCITY = 1e-3
"""m/s, over which a force that follows the sign of the velocity turns round."""
VARIABLES = {"position": "m", "velocity": "m/s", "pressure_difference": "Pa", "current": "A"}
"""What a table may be over, with units."""
UNITS = {"motion": "N", "pressure": "m3/s", "pressure_a": "m3/s", "pressure_b": "m3/s", "actuation": "A", "load": "N"}
"""Of what a law gives, by equation."""


@dataclass(frozen=True)
class Signals:
    """What laws are made of, SI units; what an equation does not know is 0."""

    position: Symbol = 0.0
    velocity: Symbol = 0.0
    pressure_a: Symbol = 0.0
    pressure_b: Symbol = 0.0
    current: Symbol = 0.0
    """Of the spool."""

    @property
    def pressure_difference(self) -> Symbol:
        """p_a - p_b."""
        return self.pressure_a - self.pressure_b


@dataclass(frozen=True)
class Law:
    """One term: `coefficient` times `shape`."""

    equation: str
    form: str
    unit: str
    """Of the coefficient; with the shape's it gives that of the equation."""
    text: str
    """The shape as an equation."""
    sentence: str
    """What such a term usually is."""
    typical: float
    """A coefficient at which it is seen."""
    shape: Callable[[Signals, Any], Symbol]
    """Of signals and the bench's numbers."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of its numbers."""
        return ("coefficient",)

    def value(self, at: Signals, n: Any, numbers: Sequence[Symbol]) -> Symbol:
        """What it gives, in the unit of its equation."""
        return numbers[0] * self.shape(at, n)


@dataclass(frozen=True)
class Table:
    """A smooth function of one variable between `low` and `high`: a sum of cubic B-splines (de Boor 1978, IX)."""

    equation: str
    variable: str
    typical: float
    """A value at which it is seen."""

    @property
    def form(self) -> str:
        """As laws are called."""
        return f"table over {self.variable}"

    @property
    def names(self) -> tuple[str, ...]:
        """Of its numbers."""
        return ("low", "high", *(f"value_{k}" for k in range(KNOTS)))

    def value(self, at: Signals, n: Any, numbers: Sequence[Symbol]) -> Symbol:
        """What it gives, in the unit of its equation."""
        low, high, *values = numbers
        along = 1.0 + clip((getattr(at, self.variable) - low) * ((KNOTS - 3) / (high - low)), 0.0, KNOTS - 3.0)
        total: Symbol = 0.0
        for k, value in enumerate(values):
            total = total + value * _cubic(np.abs(along - k))
        return total


def _cubic(distance: Symbol) -> Symbol:
    """The cubic B-spline at so many knots from its peak."""
    outer, inner = np.fmax(2.0 - distance, 0.0), np.fmax(1.0 - distance, 0.0)
    return (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0


def _sign(velocity: Symbol) -> Symbol:
    return np.tanh(velocity / SIGN_VELOCITY)


def _middle(at: Signals, n: Any) -> Symbol:
    """Position from the middle of the stroke, in strokes."""
    return at.position / n.stroke - 0.5


def _deflection(at: Signals, n: Any) -> Symbol:
    return at.position - n.spring_rest_position


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
    Law("load", "quadratic spring", "N/m2", "(x - x_rest) |x - x_rest|",
        "Load whose stiffness changes with its deflection: typical of a contact that grows.",
        1e5, lambda at, n: _deflection(at, n) * np.abs(_deflection(at, n))),
    Law("load", "lopsided spring", "N/m", "|x - x_rest|",
        "Load that is stiffer on one side of its rest: typical of a second spring or a preload that opens.",
        100.0, lambda at, n: np.abs(_deflection(at, n))),
)  # fmt: skip
"""Terms that are tried."""

TABLES: tuple[Table, ...] = (
    Table("motion", "velocity", 5.0), Table("motion", "position", 5.0), Table("load", "position", 5.0),
    Table("pressure", "pressure_difference", 1e-7), Table("pressure", "position", 1e-7),
    Table("actuation", "current", 1e-4),
)  # fmt: skip
"""Smooth functions that are tried where no law is found."""

_EVERY: tuple[Law | Table, ...] = (*LAWS, *TABLES)
ALL: dict[tuple[str, str], Law | Table] = {(one.equation, one.form): one for one in _EVERY}
"""By equation and form."""
