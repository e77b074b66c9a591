# SPDX-License-Identifier: Apache-2.0
"""Grammar of closures: the laws and tables that are tried where no named effect explains the residual.

`forces`, `flows`, `valve` and `sensors` hold the laws that have names, `words` what they are made of. All others are
`compositions` of a carrier (`force_carriers`, `flow_carriers`, `valve_carriers`, `sensor_carriers`) and a modulation
(`modulations`, `pasts`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_sim.model.grammar import flows, forces, sensors, valve
from hydro_sim.model.grammar.compositions import compositions
from hydro_sim.model.laws import Law, rounded
from hydro_sim.model.tables import Factor, Table

LAWS: tuple[Law, ...] = (*forces.LAWS, *flows.LAWS, *valve.LAWS, *sensors.LAWS)
"""Laws that have names."""
COMPOSITIONS: tuple[Law, ...] = compositions(LAWS)
"""Laws that are compositions, without those that have names."""

ROUNDED: tuple[Law, ...] = tuple(rounded(law) for law in (*LAWS, *COMPOSITIONS) if law.reverses)
"""Laws that follow the sign of the velocity, with that over which they reverse as a number."""

_VELOCITY = Factor("velocity", "v", lambda at: at.velocity)
_DIRECTION = Factor("direction", "sign(v)", lambda at: at.direction)
_ACROSS = Factor("pressure difference", "(p_a - p_b)", lambda at: at.pressure_difference, "pressure_a pressure_b")
_OWN = {"a": Factor("pressure", "p_a", lambda at: at.pressure_a, "pressure_a"),
        "b": Factor("pressure", "p_b", lambda at: at.pressure_b, "pressure_b")}  # fmt: skip
_CURRENT = Factor("current", "u", lambda at: at.current, "current")


def _tables(equation: str, unit: str, typical: float, variables: str, factor: Factor | None = None,
            where: str = "") -> list[Table]:  # fmt: skip
    return [Table(equation, variable, unit, typical, factor, where) for variable in variables.split()]


_PASTS = "past_motion elapsed"
TABLES: tuple[Table, ...] = (
    *_tables("motion", "N", 5.0, f"velocity position {_PASTS}"),
    *_tables("motion", "N s/m", 20.0, f"position pressure_difference pressure_a pressure_b {_PASTS}", _VELOCITY),
    *_tables("motion", "N", 5.0, f"position pressure_difference pressure_a pressure_b {_PASTS}", _DIRECTION),
    *_tables("load", "N", 5.0, f"position velocity {_PASTS}"),
    *_tables("load", "N s/m", 20.0, f"position {_PASTS}", _VELOCITY),
    *_tables("load", "N", 5.0, f"position {_PASTS}", _DIRECTION),
    *_tables("pressure", "m3/s", 1e-7, f"pressure_difference position velocity current past_opening {_PASTS}"),
    *_tables("pressure", "m3/s/Pa", 1e-13, f"position velocity current past_opening {_PASTS}", _ACROSS),
    *(table for chamber in "ab" for table in (
        *_tables(f"pressure_{chamber}", "m3/s", 1e-7, f"pressure_{chamber} velocity current elapsed"),
        *_tables(f"pressure_{chamber}", "m3/s/Pa", 5e-14, f"position velocity past_opening {_PASTS}", _OWN[chamber]),
        *_tables(f"pressure_{chamber}", "m2", 1e-5, f"position pressure_{chamber} elapsed", _VELOCITY))),
    *_tables("actuation", "A", 1e-4, "current past_opening elapsed"),
    *_tables("actuation", "-", 0.05, "past_opening elapsed", _CURRENT),
    *(table for cell in ("hydraulic_force", "load_force") for table in
      _tables("sensor", "N", 5.0, f"force current position velocity {_PASTS}", None, cell)),
    *(table for gauge, other in (("pressure_a", "pressure_b"), ("pressure_b", "pressure_a")) for table in
      _tables("sensor", "Pa", 3e4, f"{gauge} {other} current position velocity {_PASTS}", None, gauge)),
)  # fmt: skip
"""Smooth functions of one variable, alone or as a coefficient of a carrier, where no law is found."""

_EVERY: tuple[Law | Table, ...] = (*LAWS, *COMPOSITIONS, *ROUNDED, *TABLES)
ALL: dict[tuple[str, str], Law | Table] = {(one.equation, one.form): one for one in _EVERY}
"""By equation and form."""


def remembers(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` has hidden states."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return law is not None and law.remembers


def uses(closure: Mapping[str, Any]) -> frozenset[str]:
    """Signals that the law of an entry of a bench file's `closures` says it is made of."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return frozenset() if law is None else law.uses
