# SPDX-License-Identifier: Apache-2.0
"""Laws of the flows beside the valve: between the chambers, and out of one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.words import LAG, above, creep, middle, outwards, threshold
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Law, Number

_LAMINAR = "a gap whose width changes along the stroke: a bore that is worn or a tube that widens"
_ACROSS = threshold("pressure_difference", "Pa", -3e6, -1e6, 3e5, 1e6, 3e6)
_LEVELS = (3e6, 4e6, 5e6, 6e6, 8e6)


def _filling(pressure: str) -> Callable[[Signals, Any], Symbol]:
    """Rate at which what follows a pressure goes up or down, each over its time."""

    def rate(at: Signals, n: Any) -> Symbol:
        now = getattr(at, pressure)
        return above(now, at.memory) / at.number - above(at.memory, now) / at.second

    return rate


LAWS: tuple[Law, ...] = (
    Law("pressure", "leak along the stroke", "m3/s/Pa", "(p_a - p_b) (x/L - 1/2)",
        f"A leak between the chambers that changes along the stroke: typical of {_LAMINAR}.",
        1e-13, lambda at, n: at.pressure_difference * middle(at, n)),
    Law("pressure", "quadratic leak", "m3/s/Pa2", "(p_a - p_b) |p_a - p_b|",
        "A leak between the chambers that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_difference * np.abs(at.pressure_difference)),
    Law("pressure_a", "creeping volume", "m3/s/Pa", "(p_a - w), w' = (p_a - w) / time",
        "Chamber A goes on taking oil after its pressure has risen: typical of a hose that creeps.",
        1e-13, lambda at, n: at.pressure_a - at.memory, creep("pressure_a"), LAG),
    Law("pressure_a", "quadratic leak", "m3/s/Pa2", "p_a^2",
        "A leak of chamber A that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_a * at.pressure_a),
    Law("pressure_b", "creeping volume", "m3/s/Pa", "(p_b - w), w' = (p_b - w) / time",
        "Chamber B goes on taking oil after its pressure has risen: typical of a hose that creeps.",
        1e-13, lambda at, n: at.pressure_b - at.memory, creep("pressure_b"), LAG),
    Law("pressure_b", "quadratic leak", "m3/s/Pa2", "p_b^2",
        "A leak of chamber B that grows faster than the pressure: typical of a seal lip that lifts.",
        1e-20, lambda at, n: at.pressure_b * at.pressure_b),
    Law("pressure", "leak while moving out", "m3/s/Pa", "(p_a - p_b) where v > 0",
        "A leak between the chambers in outward motion alone: typical of a seal lip that opens one way.",
        1e-13, lambda at, n: at.pressure_difference * outwards(at.direction)),
    Law("pressure", "leak while moving in", "m3/s/Pa", "(p_a - p_b) where v < 0",
        "A leak between the chambers in inward motion alone: typical of a seal lip that opens one way.",
        1e-13, lambda at, n: at.pressure_difference * outwards(-at.direction)),
    Law("pressure", "check valve from A to B", "m3/s/Pa", "max(p_a - p_b, 0)",
        "A leak from chamber A to B, not back: typical of a seal lip or a check valve that opens one way.",
        1e-13, lambda at, n: np.fmax(at.pressure_difference, 0.0)),
    Law("pressure", "check valve from B to A", "m3/s/Pa", "-max(p_b - p_a, 0)",
        "A leak from chamber B to A, not back: typical of a seal lip or a check valve that opens one way.",
        1e-13, lambda at, n: -np.fmax(-at.pressure_difference, 0.0)),
    Law("pressure", "relief from A to B", "m3/s/Pa", "max(p_a - p_b - threshold, 0)",
        "Flow from chamber A to B above a pressure difference: typical of a cross-port relief valve.",
        1e-13, lambda at, n: above(at.pressure_difference, at.number), numbers=_ACROSS),
    Law("pressure", "relief from B to A", "m3/s/Pa", "-max(threshold - (p_a - p_b), 0)",
        "Flow from chamber B to A above a pressure difference: typical of a cross-port relief valve.",
        1e-13, lambda at, n: -above(at.number, at.pressure_difference), numbers=_ACROSS),
    Law("pressure_a", "relief", "m3/s/Pa", "max(p_a - threshold, 0)",
        "Chamber A loses oil above a pressure: typical of a relief valve.",
        1e-13, lambda at, n: above(at.pressure_a, at.number), numbers=threshold("pressure_a", "Pa", *_LEVELS)),
    Law("pressure_b", "relief", "m3/s/Pa", "max(p_b - threshold, 0)",
        "Chamber B loses oil above a pressure: typical of a relief valve.",
        1e-13, lambda at, n: above(at.pressure_b, at.number), numbers=threshold("pressure_b", "Pa", *_LEVELS)),
    *(Law(f"pressure_{chamber}", "pocket", "m3/Pa", f"w', w' = (p_{chamber} - w) / (rising or falling)",
          f"Chamber {chamber.upper()} fills a volume that gives its oil back at another rate: typical of a pocket "
          "behind a lip that lets oil in only.",
          1e-14, _filling(f"pressure_{chamber}"), Element("turn", f"pressure_{chamber}"),
          (Number("rising", "s", (0.01, 0.03, 0.1, 0.3)), Number("falling", "s", (0.01, 0.03, 0.1, 0.3))))
      for chamber in "ab"),
    *(Law(f"pressure_{chamber}", "late relief", "m3/s/Pa",
          f"w, w' = (max(p_{chamber} - threshold, 0) - w) / time",
          f"Chamber {chamber.upper()} loses oil above a pressure, late: typical of a relief valve whose poppet lags.",
          1e-13, lambda at, n: at.memory, Element("slow", f"over_{chamber}"),
          (*threshold(f"pressure_{chamber}", "Pa", *_LEVELS), Number("time", "s", (0.01, 0.03, 0.1, 0.3))))
      for chamber in "ab"),
    Law("pressure_b", "leak while moving out", "m3/s/Pa", "p_b where v > 0",
        "Chamber B loses oil while the rod moves out: typical of a rod seal that is worn on one side.",
        1e-13, lambda at, n: at.pressure_b * outwards(at.direction)),
    Law("pressure_b", "leak while moving in", "m3/s/Pa", "p_b where v < 0",
        "Chamber B loses oil while the rod moves in: typical of a rod seal that is worn on one side.",
        1e-13, lambda at, n: at.pressure_b * outwards(-at.direction)),
)  # fmt: skip
