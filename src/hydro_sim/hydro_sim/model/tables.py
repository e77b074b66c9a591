# SPDX-License-Identifier: Apache-2.0
"""Tables: smooth functions of one variable as terms of an equation (`model.laws`), for which no law was found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from hydro_sim.model.equations import Symbol, clip
from hydro_sim.model.laws import MemoryElement, Signals

KNOTS = 12
"""Number of a table's values: coefficients of as many cubic B-splines."""
VARIABLE_UNITS = {
    "position": "m", "velocity": "m/s", "pressure_difference": "Pa", "current": "A", "force": "N",
    "pressure_a": "Pa", "pressure_b": "Pa", "speed": "m/s",
}  # fmt: skip
"""Variables of tables, with units."""
VARIABLE_SIGNALS = {"pressure_difference": "pressure_a pressure_b", "speed": "velocity"}
"""Signals that a variable is computed from, if it is none itself."""


@dataclass(frozen=True)
class Factor:
    """Factor of a table, whose function is then a varying coefficient (Hastie, Tibshirani 1993)."""

    name: str
    text: str
    formula: str
    unit: str
    scale: float
    """Typical value."""
    degree: float
    uses: str
    """Signals that it depends on."""
    shape: Callable[[Signals], Symbol]


FACTORS = {
    "direction": Factor("direction", "sign(v)", "sign_v", "-", 1.0, 0.0, "velocity", lambda at: at.direction),
    "velocity": Factor("velocity", "v", "v", "m/s", 0.05, 1.0, "velocity", lambda at: at.velocity),
    "pressure_difference": Factor("pressure difference", "(p_a - p_b)", "across", "Pa", 3e6, 1.0,
                                  "pressure_a pressure_b", lambda at: at.pressure_difference),
    "pressure_a": Factor("pressure", "p_a", "p_a", "Pa", 5e6, 1.0, "pressure_a", lambda at: at.pressure_a),
    "pressure_b": Factor("pressure", "p_b", "p_b", "Pa", 5e6, 1.0, "pressure_b", lambda at: at.pressure_b),
    "current": Factor("current", "u", "u", "A", 2e-3, 1.0, "current", lambda at: at.current),
}  # fmt: skip


@dataclass(frozen=True)
class Table:
    """A smooth function of one variable between `low` and `high`: a sum of cubic B-splines (de Boor 1978, IX)."""

    equation: str
    variable: str
    unit: str
    """Unit of its values."""
    typical: float
    """Value at which the term is noticeable."""
    factor: Factor | None = None
    where: str = ""
    """Channel of a sensor."""

    memory_element: ClassVar[MemoryElement | None] = None
    depends_on_current: ClassVar[bool] = False
    has_hidden_states: ClassVar[bool] = False
    """False: tables have no memory, and no sensor's table is over the valve current."""

    @property
    def form(self) -> str:
        """Name of the table's form, as of a law's."""
        over = self.where or self.variable
        if self.where and self.variable not in (self.where, "force"):
            over = f"{self.variable} of {self.where}"
        return f"{self.factor.name} times table over {over}" if self.factor else f"table over {over}"

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its parameters."""
        return ("low", "high", *(f"value_{k}" for k in range(KNOTS)))

    @property
    def uses(self) -> frozenset[str]:
        """Signals that the table depends on."""
        own = VARIABLE_SIGNALS.get(self.variable, self.variable if self.variable != "force" else self.where)
        return frozenset(f"{own} {self.factor.uses if self.factor else ''}".split())

    def variable_value(self, at: Signals) -> Symbol:
        """Return the value of the table's variable."""
        return getattr(at, self.variable)

    def value(self, at: Signals, n: Any, parameters: Sequence[Symbol]) -> Symbol:
        """Return the value of the term, in the unit of its equation."""
        low, high, *values = parameters
        along = 1.0 + clip((self.variable_value(at) - low) * ((KNOTS - 3) / (high - low)), 0.0, KNOTS - 3.0)
        total: Symbol = 0.0
        for k, value in enumerate(values):  # times a cubic B-spline, by the distance in knots from its peak
            distance = np.abs(along - k)
            outer, inner = np.fmax(2.0 - distance, 0.0), np.fmax(1.0 - distance, 0.0)
            total = total + value * ((outer * outer * outer - 4.0 * inner * inner * inner) / 6.0)
        return total * self.factor.shape(at) if self.factor else total
