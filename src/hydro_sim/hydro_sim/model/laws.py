# SPDX-License-Identifier: Apache-2.0
"""Laws and tables: terms of one equation, written once for arrays and symbols.

Terms are linear in their amplitudes. What one gives acts in its equation::

    motion      force [N] against the motion
    pressure    flow [m3/s] out of chamber A into chamber B
    pressure_a  flow [m3/s] out of chamber A to the tank; pressure_b likewise
    actuation   spool position [A] that the edges see more than the current says
    load        force [N] of the load
    sensor      what the load cell at the rod shows more than the hydraulic force [N]

None depends on time: such a law would grow for ever. The memory of a law is one state `w` that follows a signal `s`,
its second number the time or the path over which it does; a piston at rest or a still current moves no path::

    lag   w' = (s - w) / T
    path  w' = (s' - |s'| w) / D       within [-1, 1]: Dahl 1968; Bouc and Wen with n = 1
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from hydro_sim.model.equations import Symbol, clip

KNOTS = 12
"""Numbers of a table: of so many cubic B-splines."""
SIGN_VELOCITY = 1e-3
"""Velocity [m/s] over which a force that follows the sign of the velocity reverses."""
VARIABLES = {"position": "m", "velocity": "m/s", "pressure_difference": "Pa", "current": "A"}
"""Variables of tables, with units."""


@dataclass(frozen=True)
class Signals:
    """Signals of which laws are made, SI units; those unknown to an equation are 0."""

    position: Symbol = 0.0
    velocity: Symbol = 0.0
    pressure_a: Symbol = 0.0
    pressure_b: Symbol = 0.0
    current: Symbol = 0.0
    """Position of the spool, as a current."""
    force: Symbol = 0.0
    """f_h."""
    memory: Symbol = 0.0
    """State `w` of the law."""

    @property
    def pressure_difference(self) -> Symbol:
        """p_a - p_b."""
        return self.pressure_a - self.pressure_b


@dataclass(frozen=True)
class Element:
    """Memory of a law: a state that follows one of `Signals`."""

    kind: Literal["lag", "path"]
    signal: str
    number: str
    """Name of the time [s] or the path [unit of the signal] over which it follows."""
    unit: str
    probes: tuple[float, ...]
    """Start values of a search, ascending."""

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of its parameter."""
        return 0.1 * self.probes[0], 10.0 * self.probes[-1]

    @property
    def signal_unit(self) -> str:
        """Unit of the signal that it follows."""
        return {"position": "m", "current": "A", "force": "N"}.get(self.signal, "Pa")


@dataclass(frozen=True)
class Law:
    """One term: `coefficient` times `shape`."""

    equation: str
    form: str
    unit: str
    """Unit of the coefficient; with that of the shape it gives that of the equation."""
    text: str
    """The shape as an equation."""
    sentence: str
    """Usual physical meaning of such a term."""
    typical: float
    """A coefficient at which it is noticeable."""
    shape: Callable[[Signals, Any], Symbol]
    """The shape as a function of signals and the bench's numbers."""
    element: Element | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ("coefficient",) if self.element is None else ("coefficient", self.element.number)

    def value(self, at: Signals, n: Any, numbers: Sequence[Symbol]) -> Symbol:
        """Value of the term, in the unit of its equation."""
        return numbers[0] * self.shape(at, n)


@dataclass(frozen=True)
class Factor:
    """Factor of a table, whose function is then a varying coefficient (Hastie, Tibshirani 1993)."""

    name: str
    text: str
    shape: Callable[[Signals], Symbol]


@dataclass(frozen=True)
class Table:
    """A smooth function of one variable between `low` and `high`: a sum of cubic B-splines (de Boor 1978, IX)."""

    equation: str
    variable: str
    unit: str
    """Unit of its values."""
    typical: float
    """A value at which it is noticeable."""
    factor: Factor | None = None

    @property
    def form(self) -> str:
        """Name of the form, as for laws."""
        return f"{self.factor.name} times table over {self.variable}" if self.factor else f"table over {self.variable}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ("low", "high", *(f"value_{k}" for k in range(KNOTS)))

    def along(self, at: Signals, low: Symbol, high: Symbol) -> Symbol:
        """Position of its variable among the peaks of its splines, 1 to `KNOTS` - 2."""
        return 1.0 + clip((getattr(at, self.variable) - low) * ((KNOTS - 3) / (high - low)), 0.0, KNOTS - 3.0)

    def value(self, at: Signals, n: Any, numbers: Sequence[Symbol]) -> Symbol:
        """Value of the term, in the unit of its equation."""
        low, high, *values = numbers
        along = self.along(at, low, high)
        total: Symbol = 0.0
        for k, value in enumerate(values):
            total = total + value * _cubic(np.abs(along - k))
        return total * self.factor.shape(at) if self.factor else total


def _cubic(distance: Symbol) -> Symbol:
    """The cubic B-spline at so many knots from its peak."""
    outer, inner = np.fmax(2.0 - distance, 0.0), np.fmax(1.0 - distance, 0.0)
    return (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0
