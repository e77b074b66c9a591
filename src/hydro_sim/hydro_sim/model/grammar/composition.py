# SPDX-License-Identifier: Apache-2.0
"""Laws by composition: coefficient x carrier x modulation, each part written once.

A carrier is a quantity that a textbook would put into an equation; a modulation says where, when and how much it
counts. The unit of the coefficient follows from the equation's, the carrier's and the modulation's: dimensions hold
by construction. Formula, text and sentence are put together from the parts.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from hydro_sim.model.laws import Element, Law, Number

_UNITS = {"motion": "N", "load": "N", "pressure": "m3/s", "pressure_a": "m3/s", "pressure_b": "m3/s", "actuation": "A",
          "hydraulic_force": "N", "load_force": "N", "piston_position": "m", "edges": "-"}  # fmt: skip
"""Unit of the terms of an equation or a place: of the valve's edges a term is a share of their flow."""
_SIZES = {"motion": 5.0, "load": 5.0, "pressure": 3e-7, "pressure_a": 3e-7, "pressure_b": 3e-7, "actuation": 1e-4,
          "hydraulic_force": 5.0, "load_force": 5.0, "piston_position": 1e-5, "edges": 1.0, "across": 5e-5}  # fmt: skip
"""Typical size of the same terms, in that unit."""
_GAUGE = ("Pa", 5e4)
"""Unit and typical size of a pressure sensor's terms."""


@dataclass(frozen=True)
class Carrier:
    """A quantity of an equation."""

    equation: str
    name: str
    unit: str
    text: str
    formula: str
    phrase: str
    """Beginning of the sentence."""
    scale: float
    """Typical size of the quantity [SI unit]."""
    uses: str
    """Signals that it is made of."""
    degree: float
    """Total power of the signals in it."""
    where: str = ""
    numbers: tuple[Number, ...] = ()
    size: float = 0.0
    """Typical size of the term, if it is another than its equation's."""

    @property
    def term(self) -> tuple[str, float]:
        """Unit and typical size of its term."""
        if self.equation == "sensor" and self.where.startswith("pressure"):
            return _GAUGE
        place = self.where if self.equation == "sensor" or self.where == "edges" else self.equation
        return _UNITS[place], self.size or _SIZES.get(self.where) or _SIZES[place]


@dataclass(frozen=True)
class Modulation:
    """A factor of a carrier."""

    name: str
    text: str
    """With the carrier in place of `{}`."""
    formula: str
    phrase: str
    """End of the sentence."""
    uses: str = ""
    unit: str = "-"
    scale: float = 1.0
    """Typical size of the factor [SI unit]."""
    degree: float = 0.0
    element: Element | None = None
    numbers: tuple[Number, ...] = ()
    gate: tuple[str, float] | None = None
    """A signal and the sign that it must have, if it is a gate."""


def composed(carrier: Carrier, modulation: Modulation) -> Law:
    """The law of a carrier and a modulation."""
    unit, size = carrier.term
    plain = modulation.text == "{}"
    return Law(
        carrier.equation,
        f"{carrier.name}, {modulation.name}" if modulation.name else carrier.name,
        divided(unit, carrier.unit, modulation.unit),
        modulation.text.format(carrier.text).removeprefix("" if plain else "1 "),
        f"({carrier.formula}) * ({modulation.formula})",
        size / (carrier.scale * modulation.scale),
        f"{carrier.phrase}{modulation.phrase}.",
        modulation.element,
        (*carrier.numbers, *modulation.numbers),
        carrier.where,
        frozenset(f"{carrier.uses} {modulation.uses}".split()),
        carrier.degree + modulation.degree,
        modulation.gate,
    )


_SYMBOL = r"sqrt\([^)]*\)|[A-Za-z]+"


def _powers(unit: str) -> dict[str, int]:
    """Exponents of a unit such as "N s/m2": each slash divides by the symbol behind it."""
    found: dict[str, int] = {}
    for sign, name, power in re.findall(rf"(^|[ /])({_SYMBOL})(\d*)", unit):
        found[name] = found.get(name, 0) + (-1 if sign == "/" else 1) * int(power or 1)
    return found


def divided(unit: str, *others: str) -> str:
    """A unit divided by others."""
    powers = _powers(unit)
    for other in others:
        for name, power in _powers(other).items():
            powers[name] = powers.get(name, 0) - power

    def written(sign: int) -> list[str]:
        return [f"{name}{abs(power) if abs(power) > 1 else ''}" for name, power in powers.items() if sign * power > 0]

    above, below = " ".join(written(1)), "".join(f"/{one}" for one in written(-1))
    return (above or "1") + below if above or below else "-"
