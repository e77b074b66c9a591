# SPDX-License-Identifier: Apache-2.0
"""Laws of the servo valve: of its spool, and of the flow through its edges."""

from __future__ import annotations

import numpy as np

from hydro_sim.model.equations import LAMINAR
from hydro_sim.model.grammar.modulations import TIMES
from hydro_sim.model.grammar.words import above, path, threshold, within
from hydro_sim.model.laws import Element, Law, Number

_LEAST = 0.05
"""Of the supply: a pressure drop that is taken no smaller where it is divided by."""
LAWS: tuple[Law, ...] = (
    Law("actuation", "quadratic gain", "1/A", "u |u|",
        "Flow that is not proportional to the current: typical of edges with round ports.",
        1.0, lambda at, n: at.current * np.abs(at.current)),
    Law("actuation", "cubic gain", "1/A2", "u^3",
        "Flow that saturates or grows with the current: typical of a torque motor near its limit.",
        100.0, lambda at, n: at.current * at.current * at.current),
    Law("actuation", "hysteresis", "A", "w, w' = (u' - |u'| w) / path",
        "Flow that follows another path up than down: typical of a torque motor whose iron stays magnetic.",
        2e-4, lambda at, n: at.memory, Element("path", "current"), path("A", 1e-4, 3e-4, 1e-3, 3e-3)),
    Law("actuation", "saturation", "-", "sign(u) max(|u| - threshold, 0)",
        "Flow that follows the current otherwise beyond an opening: typical of ports of two widths, or a torque motor "
        "near its limit.",
        0.05, lambda at, n: above(at.current, at.number) - above(-at.current, at.number),
        numbers=threshold("opening", "A", 3e-4, 1e-3, 2e-3, 4e-3, 8e-3)),
    Law("actuation", "gain near null", "-", "sign(u) min(|u|, threshold)",
        "Flow that follows the current otherwise up to an opening: typical of notches in the lands.",
        0.05, lambda at, n: within(at.current, at.number),
        numbers=threshold("opening", "A", 3e-4, 1e-3, 2e-3, 4e-3, 8e-3)),
    Law("actuation", "rounded gain", "-", "(u - u / sqrt(1 + (u / level)^2))",
        "Flow that grows ever less with the current: typical of a torque motor whose iron saturates; -1: all of it.",
        0.3, lambda at, n: at.current - at.current / np.sqrt(1.0 + (at.current / at.number) * (at.current / at.number)),
        numbers=(Number("level", "A", (2e-3, 5e-3, 1e-2, 2e-2, 5e-2)),)),
    Law("actuation", "rate limit", "-", "(w - u), w' = (u - w) / time within +-rate",
        "A spool that lags, and moves no faster than a rate: typical of a pilot stage that saturates; 1: all of it.",
        1.0, lambda at, n: at.memory - at.current, Element("rate", "current"),
        (Number("rate", "A/s", (0.03, 0.1, 0.3, 1.0)), Number("time", "s", (2e-4, 1e-3, 5e-3)))),
    Law("actuation", "late share", "-", "(w - u), w' = (u - w) / time",
        "A share of the opening that comes late: typical of eddies in a torque motor's iron, or of a spool that "
        "creeps; 1: all of it.",
        0.1, lambda at, n: at.memory - at.current, Element("lag", "current"),
        (Number("time", "s", (0.01, 0.03, 0.1, 0.3, 1.0)),)),
    Law("actuation", "rises and falls", "-", "(w - u), w' = (u - w) / (rising or falling)",
        "A spool that follows rises and falls at different rates: typical of a pilot stage of which one nozzle is half "
        "clogged; 1: all of it.",
        1.0, lambda at, n: at.memory - at.current, Element("turn", "current"),
        (Number("rising", "s", (3e-4, 1e-3, 4e-3)), Number("falling", "s", (3e-4, 1e-3, 4e-3)))),
    Law("actuation", "falling supply", "Pa", "q (1 - exp(-t / time)) / (2 dp) from the supply",
        "Edges that are fed by a pressure that falls from the start: typical of a pump's relief valve that sets down "
        "as it warms, or an accumulator that empties.",
        5e5, lambda at, n: 0.5 * at.feeds * at.memory / np.fmax(np.abs(at.drop), _LEAST * n.supply_pressure),
        Element("slow", "time"), (Number("time", "s", TIMES),), where="edges",
        uses=frozenset({"current", "pressure_a", "pressure_b", "time"})),
    Law("actuation", "laminar edges", "-", "q (1 - sqrt(|dp| / (|dp| + transition)))",
        "Edges that pass less at small pressure drops: typical of flow that is laminar below and turbulent above; "
        "1: all of it.",
        1.0, lambda at, n: 1.0 - np.sqrt((np.abs(at.drop) + LAMINAR) / (np.abs(at.drop) + LAMINAR + at.number)),
        where="edges", numbers=(Number("transition", "Pa", (1e5, 3e5, 1e6, 3e6)),)),
    Law("actuation", "flow force", "1/Pa", "q |dp|",
        "Edges that pass less the larger the pressure drop: typical of flow forces that close the spool, or of oil "
        "that cavitates.",
        1e-9, lambda at, n: np.abs(at.drop), where="edges"),
)  # fmt: skip
