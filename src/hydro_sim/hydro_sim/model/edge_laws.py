# SPDX-License-Identifier: Apache-2.0
"""What laws of the valve's edges do to the flows of both chambers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol, edge_drops, orifice
from hydro_sim.model.law_signals import Signals


def edge_losses(
    n: Any, openings: tuple[Symbol, Symbol], pressures: tuple[Symbol, Symbol], share: Callable[[Signals], Symbol]
) -> tuple[Symbol, Symbol]:
    """Flows [m3/s] that chambers A and B lack where a share [-] of each edge's flow does not pass.

    Parameters
    ----------
    n
        The bench's numbers.
    openings
        Conductance [m3/s/sqrt(Pa)] of the edges that drive the piston out, and back.
    pressures
        p_a, p_b [Pa].
    share
        Share of an edge's flow, by its pressure drop, its conductance and whether it feeds.
    """
    out, back = openings
    drops_out, drops_back = edge_drops(n.supply_pressure, n.tank_pressure, *pressures)
    side = Signals(pressure_a=pressures[0], pressure_b=pressures[1], current=out - back)

    over_out, over_back = drops_out[0] + drops_out[1], drops_back[0] + drops_back[1]

    def fed(opened: Symbol, drop: Symbol, both: Symbol) -> Symbol:
        return share(side.but(drop=drop, both=both, opened=opened, feeds=1.0)) * orifice(opened, drop)

    def drained(opened: Symbol, drop: Symbol, both: Symbol) -> Symbol:
        return share(side.but(drop=drop, both=both, opened=opened)) * orifice(opened, drop)

    lost_a = fed(out, drops_out[0], over_out) - drained(back, drops_back[0], over_back)
    return lost_a, fed(back, drops_back[1], over_back) - drained(out, drops_out[1], over_out)


def shifted(n: Any, spool: Symbol, shift: Symbol, pressures: tuple[Symbol, Symbol]) -> tuple[Symbol, Symbol]:
    """Flows [m3/s] that chambers A and B lack where the edges see a spool [A] that is shifted [A]."""
    p_a, p_b = pressures
    drops_out, drops_back = edge_drops(n.supply_pressure, n.tank_pressure, p_a, p_b)
    to_a, to_b = 0.0, 0.0
    for sign, position in ((1.0, spool), (-1.0, spool + shift)):
        out, back = n.valve_gain * np.fmax(position, 0.0), n.valve_gain * np.fmax(-position, 0.0)
        to_a = to_a + sign * (orifice(out, drops_out[0]) - orifice(back, drops_back[0]))
        to_b = to_b + sign * (orifice(back, drops_back[1]) - orifice(out, drops_out[1]))
    return to_a, to_b
