# SPDX-License-Identifier: Apache-2.0
"""Which modulations a carrier may have, by equation: those whose signals stand there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hydro_sim.model.grammar import carriers as c
from hydro_sim.model.grammar import modulations as m
from hydro_sim.model.grammar import pasts as p
from hydro_sim.model.grammar import sensor_carriers as s
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
_LEVELS_N, _LEVELS_PA = (-100.0, -30.0, 0.0, 30.0, 100.0), (3e6, 4e6, 5e6, 6e6, 8e6)
_READINGS = {
    **{cell: (*p.of_reading(cell, "force", symbol, "N", (3.0, 10.0, 30.0, 100.0), _LEVELS_N),
              *p.of_sides(cell, symbol), p.both_sides(cell, symbol, (20.0, 60.0, 150.0)))
       for cell, symbol in (("hydraulic_force", "f_h"), ("load_force", "f_l"))},
    **{gauge: p.of_reading(gauge, gauge, f"p_{gauge[-1]}", "Pa", (3e4, 1e5, 3e5, 1e6), _LEVELS_PA)
       for gauge in ("pressure_a", "pressure_b")},
    "piston_position": (*p.of_reading("piston_position", "position", "x", "m", (1e-4, 3e-4, 1e-3, 3e-3), ())[:1],
                        *p.BENT),
}  # fmt: skip


def _product(carriers: Iterable[Carrier], modulations: Sequence[Modulation]) -> list[Law]:
    return [composed(carrier, modulation) for carrier in carriers for modulation in modulations]


EVERY: tuple[Law, ...] = (
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
    *_product(s.PICKED, (m.ALWAYS,)),
    *_product(s.DRIFTING, _DRIFTS),
    *_product((one for one in s.DRIFTING if one.uses and not one.where.endswith("force")), (m.ALWAYS,)),
    *(composed(s.READ[channel], one) for channel, own in _READINGS.items() for one in own),
)
"""All compositions, named laws among them."""


def compositions(named: Iterable[Law]) -> tuple[Law, ...]:
    """All compositions that no named law writes already."""
    known = {(law.equation, law.where, law.text) for law in named}
    return tuple(law for law in EVERY if (law.equation, law.where, law.text) not in known)
