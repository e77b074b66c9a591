# SPDX-License-Identifier: Apache-2.0
"""What the catalogue is written in: numbers with their ranges, and forms of a cause."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any


@dataclass(frozen=True)
class Quantity:
    """A number of an effect and the range in which it is simulated."""

    name: str
    unit: str
    low: float
    high: float

    def of(self, effect: str, parameters: Mapping[str, Any]) -> float:
        """Its value.

        Raises
        ------
        ValueError
            If it is missing or not a number in range.
        """
        if self.name not in parameters:
            raise ValueError(f"effect {effect} lacks its parameter {self.name} [{self.unit}]")
        try:
            value = float(parameters[self.name])  # PyYAML reads 1e9 as a text
        except (TypeError, ValueError):
            value = float("nan")
        if not (isfinite(value) and self.low <= value <= self.high):
            wanted = f"a number in [{self.low:g}, {self.high:g}] {self.unit}"
            raise ValueError(f"effect {effect}: {self.name} = {parameters[self.name]!r} is not {wanted}")
        return value


@dataclass(frozen=True)
class Form:
    """One form of a cause. A form without a hook changes a number of the bench (`hydro_sim.model.effects.program`)."""

    quantities: tuple[Quantity, ...]
    hook: int | None = None
    kind: int = 0
    constants: tuple[float, ...] = ()
    """Follow the parameters in the program's entry."""
