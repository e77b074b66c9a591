# SPDX-License-Identifier: Apache-2.0
"""Grammar of closures: the laws and tables that are tried where no named effect explains the residual.

`forces`, `flows`, `valve` and `sensors` hold the laws that have names, `words` what they are made of. All others are
compositions of `carriers` and `modulations`.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_sim.model.grammar import flows, forces, sensors, valve
from hydro_sim.model.grammar.compositions import compositions
from hydro_sim.model.grammar.words import sign
from hydro_sim.model.laws import Law
from hydro_sim.model.tables import Factor, Table

LAWS: tuple[Law, ...] = (*forces.LAWS, *flows.LAWS, *valve.LAWS, *sensors.LAWS)
"""Laws that have names."""
COMPOSITIONS: tuple[Law, ...] = compositions(LAWS)
"""Laws that are compositions, without those that have names."""

_VELOCITY = Factor("velocity", "v", lambda at: at.velocity)
_DIRECTION = Factor("direction", "sign(v)", lambda at: sign(at.velocity))
_ACROSS = Factor("pressure difference", "(p_a - p_b)", lambda at: at.pressure_difference)

TABLES: tuple[Table, ...] = (
    Table("motion", "velocity", "N", 5.0), Table("motion", "position", "N", 5.0), Table("load", "position", "N", 5.0),
    Table("pressure", "pressure_difference", "m3/s", 1e-7), Table("pressure", "position", "m3/s", 1e-7),
    Table("actuation", "current", "A", 1e-4),
    Table("motion", "position", "N s/m", 20.0, _VELOCITY), Table("motion", "position", "N", 5.0, _DIRECTION),
    Table("motion", "pressure_difference", "N", 5.0, _DIRECTION),
    Table("pressure", "position", "m3/s/Pa", 1e-13, _ACROSS),
    *(Table("sensor", "force", "N", 5.0, where=cell) for cell in ("hydraulic_force", "load_force")),
    *(Table("sensor", gauge, "Pa", 3e4, where=gauge) for gauge in ("pressure_a", "pressure_b")),
)  # fmt: skip
"""Smooth functions that are tried where no law is found: of each variable, and what laws of two variables vary with."""

_EVERY: tuple[Law | Table, ...] = (*LAWS, *COMPOSITIONS, *TABLES)
ALL: dict[tuple[str, str], Law | Table] = {(one.equation, one.form): one for one in _EVERY}
"""By equation and form."""


def remembers(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` has hidden states."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return isinstance(law, Law) and law.remembers
