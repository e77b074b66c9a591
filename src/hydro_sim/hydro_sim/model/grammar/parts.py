# SPDX-License-Identifier: Apache-2.0
"""Laws by composition: coefficient x carrier x modulation, each part written once.

A carrier is a quantity that a textbook would put into an equation; a modulation says where, when and how much it
counts. The unit of the coefficient follows from the equation's, the carrier's and the modulation's: dimensions hold
by construction. Text and sentence are put together from the parts.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from hydro_sim.model.equations import Symbol
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Law, Number

EQUATION_UNITS = {
    "motion": "N", "load": "N", "pressure": "m3/s", "pressure_a": "m3/s", "pressure_b": "m3/s", "actuation": "A",
    }  # fmt: skip
"""Unit of an equation's terms."""


@dataclass(frozen=True, kw_only=True)
class Carrier:
    """A quantity of an equation."""

    equation: str
    name: str
    unit: str
    text: str
    phrase: str
    """Beginning of the sentence."""
    size: float
    """Typical size of the equation's term [SI unit]."""
    scale: float = 1.0
    """Typical size of the quantity [SI unit]."""
    shape: Callable[[Signals, Any], Symbol]
    uses: str = ""
    """Signals that it is made of."""
    degree: float = 0.0
    """Total power of the signals in it."""
    where: str = ""
    numbers: tuple[Number, ...] = ()


@dataclass(frozen=True, kw_only=True)
class Modulation:
    """A factor of a carrier."""

    name: str
    text: str
    """With the carrier in place of `{}`."""
    phrase: str
    """End of the sentence."""
    factor: Callable[[Signals, Any], Symbol]
    unit: str = "-"
    scale: float = 1.0
    """Typical size of the factor [SI unit]."""
    uses: str = ""
    degree: float = 0.0
    element: Element | None = None
    numbers: tuple[Number, ...] = ()
    gate: tuple[str, float] | None = None
    """A signal and the sign that it must have, if it is a gate."""


def composed(carrier: Carrier, modulation: Modulation) -> Law:
    """The law of a carrier and a modulation."""
    of = _unit_of(carrier)
    return Law(
        carrier.equation,
        f"{carrier.name}, {modulation.name}" if modulation.name else carrier.name,
        divided(of, carrier.unit, modulation.unit),
        modulation.text.format(carrier.text).removeprefix("1 " if modulation.name and modulation.text != "{}" else ""),
        f"{carrier.phrase}{modulation.phrase}.",
        carrier.size / (carrier.scale * modulation.scale),
        lambda at, n: carrier.shape(at, n) * modulation.factor(at, n),
        modulation.element,
        (*carrier.numbers, *modulation.numbers),
        carrier.where,
        frozenset(f"{carrier.uses} {modulation.uses}".split()),
        carrier.degree + modulation.degree,
        modulation.gate,
    )


def _unit_of(carrier: Carrier) -> str:
    """Unit of a carrier's equation; of the valve's edges a term is a share of their flow."""
    if carrier.equation == "sensor":
        units = {"hydraulic_force": "N", "load_force": "N", "piston_position": "m"}
        return units.get(carrier.where, "Pa")
    return "-" if carrier.where == "edges" else EQUATION_UNITS[carrier.equation]


_POWER = re.compile(r"(sqrt\(Pa\)|sqrt\(m/s\)|[A-Za-z]+)(\d*)")


def _powers(unit: str) -> dict[str, int]:
    """Exponents of a unit such as "N s/m2": each slash divides by the symbol behind it."""
    found: dict[str, int] = {}
    for sign, part in re.findall(r"(^|[ /])(sqrt\([^)]*\)|[A-Za-z]+\d*)", unit):
        name, power = _POWER.fullmatch(part).groups()  # type: ignore[union-attr]
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
