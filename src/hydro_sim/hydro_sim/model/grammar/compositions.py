# SPDX-License-Identifier: Apache-2.0
"""Which modulations a carrier may have, by equation: those whose signals stand there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hydro_sim.model.grammar import flow_carriers as q
from hydro_sim.model.grammar import force_carriers as f
from hydro_sim.model.grammar import modulations as m
from hydro_sim.model.grammar import pasts as p
from hydro_sim.model.grammar import products as x
from hydro_sim.model.grammar import sensor_carriers as s
from hydro_sim.model.grammar import valve_carriers as v
from hydro_sim.model.grammar.parts import Carrier, Modulation, composed
from hydro_sim.model.laws import Law

_FORCES = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BEYOND_PLACE, *m.BEYOND_PRESSURE, m.AT_PLACE, m.BY_MOTION_PAST,
           m.BY_LOADING, m.BY_TIME, p.FADING, p.REVERSED)  # fmt: skip
_LOADS = (*m.BY_MOTION, *m.BEYOND_PLACE, m.AT_PLACE, m.BY_MOTION_PAST, m.BY_TIME, p.FADING, p.REVERSED)
_FLOWS = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BY_SIDE, *m.BEYOND_PLACE, *m.BEYOND_SPEED, *m.BEYOND_PRESSURE, m.AT_PLACE,
          m.BY_MOTION_PAST, m.BY_THROTTLING, m.BY_HEATING, m.BY_LOADING, m.BY_TIME, p.FADING, p.REVERSED,
          p.SEATED)  # fmt: skip
_SPOOL = (*m.BY_SIDE, m.BY_THROTTLING, m.BY_HEATING, m.BY_TIME, p.FADING)
_FED = (m.BY_THROTTLING, m.BY_TIME, p.FADING)
_EDGES = (m.ALWAYS, *m.BY_EDGE, *m.BY_SIDE)
_DRIFTS = (m.BY_TIME, m.BY_MOTION_PAST, p.FADING)
_PRESSING = (x.BY_P_A, x.BY_P_B, x.BY_ACROSS)
_GAPS = (x.BY_BEND, x.BY_STROKE, x.BY_SPEED, x.BY_OPENING)
_LEVELS_N, _LEVELS_PA = (-100.0, -30.0, 0.0, 30.0, 100.0), (3e6, 4e6, 5e6, 6e6, 8e6)
_READINGS = {
    **{cell: (*p.of_reading(cell, "force", symbol, "N", (3.0, 10.0, 30.0, 100.0), _LEVELS_N),
              *p.of_sides(cell, symbol), *p.both_sides(cell, symbol, (20.0, 60.0, 150.0)))
       for cell, symbol in (("hydraulic_force", "f_h"), ("load_force", "f_l"))},
    **{gauge: p.of_reading(gauge, gauge, f"p_{gauge[-1]}", "Pa", (3e4, 1e5, 3e5, 1e6), _LEVELS_PA)
       for gauge in ("pressure_a", "pressure_b")},
    "piston_position": (*p.of_reading("piston_position", "position", "x", "m", (1e-4, 3e-4, 1e-3, 3e-3), ())[:1],
                        *p.BENT),
}  # fmt: skip


def _product(carriers: Iterable[Carrier], modulations: Sequence[Modulation]) -> list[Law]:
    return [composed(carrier, modulation) for carrier in carriers for modulation in modulations]


EVERY: tuple[Law, ...] = (
    *_product((f.DRY,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((f.VISCOUS,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((f.SQUARE, f.ROOT, *f.BY_PRESSURE, f.BY_DIFFERENCE), _FORCES),
    *_product((f.STIFFNESS,), (m.ALWAYS, *_LOADS)),
    *_product((f.CONSTANT_FORCE,), (*_FORCES, *m.BEYOND_SPEED, m.FILM)),
    *_product((f.LOAD_DRY, f.LOAD_VISCOUS), (m.ALWAYS, *_LOADS, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((f.LOAD_SQUARE, f.LOAD_RUBBING), (m.ALWAYS, *_LOADS)),
    *_product((f.LOAD_SPRING, f.LOAD_CONSTANT), _LOADS),
    *_product((f.LOAD_INERTIA,), (m.ALWAYS, *m.BEYOND_PLACE)),
    *_product((q.LEAK, q.HOLE), _FLOWS),
    *_product(q.CHAMBERS, (m.ALWAYS, *_FLOWS)),
    *_product(q.FED, (m.ALWAYS, *_FED)),
    *_product((v.NULL,), (*m.BEYOND_OPENING, *_SPOOL)),
    *_product((v.GAIN, v.CURVE), _SPOOL),
    *_product((v.THROTTLE, v.NARROWED, v.JETS), _EDGES),
    *_product(v.PRESSED, (m.ALWAYS,)),
    *_product((v.CHOKED,), (m.ALWAYS, *m.BY_EDGE)),
    *_product((f.DRY,), (x.BY_BEND,)),
    *_product((f.VISCOUS,), (x.BY_BEND, *_PRESSING)),
    *_product((f.STIFFNESS,), (*_PRESSING, x.BY_SPEED)),
    *_product((f.LOAD_SPRING,), (x.BY_SPEED,)),
    *_product(q.CONSTANT, (m.BY_TIME, p.FADING)),
    *_product(q.PORTS, m.BEYOND_PLACE),
    *_product((*f.BY_PRESSURE, f.BY_DIFFERENCE), (p.RESTED,)),
    *_product(f.PRESSING, (p.PRESLIDING,)),
    *_product((f.CONSTANT_FORCE, f.LOAD_CONSTANT), (x.RIPPLE, x.BY_SPEED)),
    *_product((f.CONSTANT_FORCE, f.STIFFNESS), (x.BY_BEND,)),
    *_product((f.CONSTANT_FORCE,), (x.BY_P_A, x.BY_P_B)),
    *_product((f.DRY, f.VISCOUS, q.LEAK), (x.WAVES,)),
    *_product((f.DRY, f.VISCOUS), p.RISING),
    *_product((f.LOAD_VISCOUS, f.LOAD_SQUARE), (x.BY_BEND,)),
    *_product((f.BENDING,), (p.PRESLIDING,)),
    *_product((q.LEAK, q.HOLE), (*_GAPS, p.RESTED, p.WIPED)),
    *_product(q.OF_PORT, (m.ALWAYS,)),
    *_product(q.CHAMBERS, _GAPS),
    *_product(q.CARRIED, (x.BY_P_A, x.BY_P_B)),
    *(composed(one, p.STORING[one.equation]) for one in q.CHAMBERS if one.name == "leak"),
    *_product((*s.PICKED, s.BENT_BY_LOAD), (m.ALWAYS,)),
    *_product((one for one in s.PICKED if one.text == "u"), m.BY_SIDE),
    *_product(s.DRIFTING, _DRIFTS),
    *_product(s.GAINS, (x.BY_OPENING, x.BY_CURRENT, x.BY_SPEED, x.BY_PLACE)),
    *_product((s.GAINS_OF["pressure_a"],), (x.BY_P_B,)),
    *_product((s.GAINS_OF["pressure_b"],), (x.BY_P_A,)),
    composed(s.READ["piston_position"], x.RIPPLE),
    *_product((one for one in s.DRIFTING if one.uses and not one.where.endswith("force")), (m.ALWAYS,)),
    *(composed(s.READ[channel], one) for channel, own in _READINGS.items() for one in own),
)
"""All compositions, named laws among them."""


def compositions(named: Iterable[Law]) -> tuple[Law, ...]:
    """All compositions that no named law writes already."""
    known = {(law.equation, law.where, law.text) for law in named}
    return tuple(law for law in EVERY if (law.equation, law.where, law.text) not in known)
