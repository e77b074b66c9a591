# SPDX-License-Identifier: Apache-2.0
"""Laws of the sensors: readings that are not straight, and a cell that creeps."""

from __future__ import annotations

import numpy as np

from hydro_sim.model.grammar.words import LAG, creep
from hydro_sim.model.laws import Element, Law, Number

_CELLS = (("hydraulic_force", "f_h", "piston rod"), ("load_force", "f_l", "load"))


def _of_cell(channel: str, symbol: str, place: str) -> tuple[Law, ...]:
    bent = f"The load cell at the {place} reads a curve instead of a line: typical of a cell that is"
    return (
        Law("sensor", f"quadratic reading of {channel}", "1/N", f"{symbol}^2",
            f"{bent} not alike in tension and compression.",
            3e-5, lambda at, n: at.force * at.force, where=channel),
        Law("sensor", f"odd quadratic reading of {channel}", "1/N", f"{symbol} |{symbol}|",
            f"{bent} loaded beyond its range.",
            3e-5, lambda at, n: at.force * np.abs(at.force), where=channel),
        Law("sensor", f"cubic reading of {channel}", "1/N2", f"{symbol}^3",
            f"{bent} loaded beyond its range.",
            1e-7, lambda at, n: at.force * at.force * at.force, where=channel),
    )  # fmt: skip


def _of_gauge(chamber: str) -> Law:
    return Law("sensor", f"quadratic reading of pressure_{chamber}", "1/Pa", f"p_{chamber}^2",
               f"The pressure sensor of chamber {chamber.upper()} reads a curve instead of a line: typical of a "
               "membrane that is bent too far.",
               1e-9, _SQUARES[chamber], where=f"pressure_{chamber}")  # fmt: skip


def _snubber(chamber: str) -> Law:
    return Law("sensor", f"snubber of pressure_{chamber}", "-",
               f"(w - p_{chamber}), w' = (p_{chamber} - w) / (rising or falling)",
               f"The pressure sensor of chamber {chamber.upper()} follows rises and falls at different rates: typical "
               "of a snubber with a check valve; 1: all of it.",
               1.0, lambda at, n: at.memory - getattr(at, f"pressure_{chamber}"),
               Element("turn", f"pressure_{chamber}"),
               (Number("rising", "s", (5e-4, 2e-3, 1e-2)), Number("falling", "s", (5e-4, 2e-3, 1e-2))),
               where=f"pressure_{chamber}")  # fmt: skip


_SQUARES = {"a": lambda at, n: at.pressure_a * at.pressure_a, "b": lambda at, n: at.pressure_b * at.pressure_b}
LAWS: tuple[Law, ...] = (
    Law("sensor", "creep of the cell at the rod", "-", "w, w' = (f_h - w) / time",
        "The load cell at the piston rod goes on rising under a force that stays: typical of a glued strain gauge.",
        0.05, lambda at, n: at.memory, creep("force"), LAG, where="hydraulic_force"),
    *(law for cell in _CELLS for law in _of_cell(*cell)),
    *(_of_gauge(chamber) for chamber in "ab"),
    *(_snubber(chamber) for chamber in "ab"),
)  # fmt: skip
