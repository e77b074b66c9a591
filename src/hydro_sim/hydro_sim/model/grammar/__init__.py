# SPDX-License-Identifier: Apache-2.0
"""Grammar of closures: the laws and tables that are tried where no named effect explains the residual.

`named` holds the laws that have names. All others are compositions of one of the `carriers` and one of the
`modulations`: those whose signals stand in the carrier's equation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from hydro_sim.model.grammar import carriers as c
from hydro_sim.model.grammar import modulations as m
from hydro_sim.model.grammar.composition import Carrier, Modulation, composed
from hydro_sim.model.grammar.named import LAWS as LAWS
from hydro_sim.model.laws import Law, rounded
from hydro_sim.model.tables import Factor, Table

_FORCES = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BEYOND_PLACE, *m.BEYOND_PRESSURE, m.AT_PLACE, m.BY_MOTION_PAST,
           m.BY_LOADING, m.BY_TIME, m.FADING, m.REVERSED)  # fmt: skip
_LOADS = (*m.BY_MOTION, *m.BEYOND_PLACE, m.AT_PLACE, m.BY_MOTION_PAST, m.BY_TIME, m.FADING, m.REVERSED)
_FLOWS = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BY_SIDE, *m.BEYOND_PLACE, *m.BEYOND_SPEED, *m.BEYOND_PRESSURE, m.AT_PLACE,
          m.BY_MOTION_PAST, m.BY_THROTTLING, m.BY_HEATING, m.BY_LOADING, m.BY_TIME, m.FADING, m.REVERSED,
          m.SEATED)  # fmt: skip
_SPOOL = (*m.BY_SIDE, m.BY_THROTTLING, m.BY_HEATING, m.BY_TIME, m.FADING)
_FED = (m.BY_THROTTLING, m.BY_TIME, m.FADING)
_EDGES = (m.ALWAYS, *m.BY_EDGE, *m.BY_SIDE)
_DRIFTS = (m.BY_TIME, m.BY_MOTION_PAST, m.FADING)
_PRESSING = (m.BY_P_A, m.BY_P_B, m.BY_ACROSS)
_GAPS = (m.BY_BEND, m.BY_STROKE, m.BY_SPEED, m.BY_OPENING)
_READINGS = {
    **{cell: (*m.of_reading(cell, symbol, "f", "N", (3.0, 10.0, 30.0, 100.0), -100.0, -30.0, 0.0, 30.0, 100.0),
              *m.of_sides(cell, symbol))
       for cell, symbol in (("hydraulic_force", "f_h"), ("load_force", "f_l"))},
    **{f"pressure_{gauge}": m.of_reading(f"pressure_{gauge}", f"p_{gauge}", f"p_{gauge}", "Pa", (3e4, 1e5, 3e5, 1e6),
                                         *m.LEVELS)
       for gauge in "ab"},
    "piston_position": (*m.of_reading("piston_position", "x", "x", "m", (1e-4, 3e-4, 1e-3, 3e-3)), *m.BENT),
}  # fmt: skip


def _product(carriers: Iterable[Carrier], modulations: Sequence[Modulation]) -> list[Law]:
    return [composed(carrier, modulation) for carrier in carriers for modulation in modulations]


_PRODUCTS: tuple[Law, ...] = (
    *_product((c.DRY,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.VISCOUS,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.SQUARE, c.ROOT, *c.BY_PRESSURE, c.BY_DIFFERENCE), _FORCES),
    *_product((c.STIFFNESS,), (m.ALWAYS, *_LOADS)),
    *_product((c.CONSTANT_FORCE,), (*_FORCES, *m.BEYOND_SPEED, m.FILM)),
    *_product((c.LOAD_DRY, c.LOAD_VISCOUS), (m.ALWAYS, *_LOADS, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.LOAD_SQUARE, c.LOAD_RUBBING), (m.ALWAYS, *_LOADS)),
    *_product((c.LOAD_SPRING, c.LOAD_CONSTANT), _LOADS),
    *_product((c.LOAD_INERTIA,), (m.ALWAYS, *m.BEYOND_PLACE)),
    *_product((c.LEAK, c.HOLE), _FLOWS),
    *_product(c.CHAMBERS, (m.ALWAYS, *_FLOWS)),
    *_product(c.FED, (m.ALWAYS, *_FED)),
    *_product((c.NULL,), (*m.BEYOND_OPENING, *_SPOOL)),
    *_product((c.GAIN, c.CURVE), _SPOOL),
    *_product((c.THROTTLE, c.NARROWED, c.JETS), _EDGES),
    *_product(c.PRESSED, (m.ALWAYS,)),
    *_product((c.CHOKED,), (m.ALWAYS, *m.BY_EDGE)),
    *_product((c.DRY,), (m.BY_BEND,)),
    *_product((c.VISCOUS,), (m.BY_BEND, *_PRESSING)),
    *_product((c.STIFFNESS,), (*_PRESSING, m.BY_SPEED)),
    *_product((c.LOAD_SPRING,), (m.BY_SPEED,)),
    *_product(c.CONSTANT, (m.BY_TIME, m.FADING)),
    *_product(c.PORTS, m.BEYOND_PLACE),
    *_product((*c.BY_PRESSURE, c.BY_DIFFERENCE), (m.RESTED,)),
    *_product(c.PRESSING, (m.PRESLIDING,)),
    *_product((c.CONSTANT_FORCE, c.LOAD_CONSTANT), (m.RIPPLE, m.BY_SPEED)),
    *_product((c.CONSTANT_FORCE, c.STIFFNESS), (m.BY_BEND,)),
    *_product((c.CONSTANT_FORCE,), (m.BY_P_A, m.BY_P_B)),
    *_product((c.DRY, c.VISCOUS, c.LEAK), (m.WAVES,)),
    *_product((c.DRY, c.VISCOUS), m.RISING),
    *_product((c.LOAD_VISCOUS, c.LOAD_SQUARE), (m.BY_BEND,)),
    *_product((c.BENDING,), (m.PRESLIDING,)),
    *_product((c.LEAK, c.HOLE), (*_GAPS, m.RESTED, m.WIPED)),
    *_product(c.OF_PORT, (m.ALWAYS,)),
    *_product(c.CHAMBERS, _GAPS),
    *_product(c.CARRIED, (m.BY_P_A, m.BY_P_B)),
    *(composed(one, m.STORING[one.equation]) for one in c.CHAMBERS if one.name == "leak"),
    *_product((*c.PICKED, c.BENT_BY_LOAD), (m.ALWAYS,)),
    *_product((one for one in c.PICKED if one.text == "u"), m.BY_SIDE),
    *_product(c.DRIFTING, _DRIFTS),
    *_product(c.GAINS_OF.values(), (m.BY_OPENING, m.BY_CURRENT, m.BY_SPEED, m.BY_PLACE)),
    *_product((c.GAINS_OF["pressure_a"],), (m.BY_P_B,)),
    *_product((c.GAINS_OF["pressure_b"],), (m.BY_P_A,)),
    composed(c.READ["piston_position"], m.RIPPLE),
    *_product((one for one in c.DRIFTING if one.uses and not one.where.endswith("force")), (m.ALWAYS,)),
    *(composed(c.READ[channel], one) for channel, own in _READINGS.items() for one in own),
)
_KNOWN = {(law.equation, law.where, law.text) for law in LAWS}
COMPOSITIONS = tuple(law for law in _PRODUCTS if (law.equation, law.where, law.text) not in _KNOWN)
"""Laws that are compositions, without those that have names."""
ROUNDED = tuple(rounded(law) for law in (*LAWS, *COMPOSITIONS) if law.reverses)
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


def reverses(closure: Mapping[str, Any]) -> bool:
    """Return whether an entry of a bench file's `closures` is a law that follows the sign of the velocity."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return isinstance(law, Law) and law.reverses


def uses(closure: Mapping[str, Any]) -> frozenset[str]:
    """Signals that the law of an entry of a bench file's `closures` says it is made of."""
    law = ALL.get((str(closure["equation"]), str(closure["form"])))
    return frozenset() if law is None else law.uses
