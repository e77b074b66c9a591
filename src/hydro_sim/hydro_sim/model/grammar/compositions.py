# SPDX-License-Identifier: Apache-2.0
"""Which modulations a carrier may have, by equation: those whose signals stand there."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hydro_sim.model.grammar import carriers as c
from hydro_sim.model.grammar import modulations as m
from hydro_sim.model.grammar.parts import Carrier, Modulation, composed
from hydro_sim.model.laws import Law

_FORCES = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BEYOND_PLACE, *m.BEYOND_PRESSURE, m.AT_PLACE, m.BY_MOTION_PAST,
           m.BY_LOADING, m.BY_TIME)  # fmt: skip
_LOADS = (*m.BY_MOTION, *m.BEYOND_PLACE, m.AT_PLACE, m.BY_MOTION_PAST, m.BY_TIME)
_FLOWS = (*m.BY_MOTION, *m.BY_PRESSURE, *m.BY_SIDE, *m.BEYOND_PLACE, *m.BEYOND_SPEED, *m.BEYOND_PRESSURE, m.AT_PLACE,
          m.BY_MOTION_PAST, m.BY_THROTTLING, m.BY_HEATING, m.BY_LOADING, m.BY_TIME)  # fmt: skip
_SPOOL = (*m.BY_SIDE, m.BY_THROTTLING, m.BY_HEATING, m.BY_TIME)
_EDGES = (m.ALWAYS, *m.BY_EDGE, *m.BY_SIDE)
_DRIFTS = (m.BY_TIME, m.BY_MOTION_PAST)


def _product(carriers: Iterable[Carrier], modulations: Sequence[Modulation]) -> list[Law]:
    return [composed(carrier, modulation) for carrier in carriers for modulation in modulations]


EVERY: tuple[Law, ...] = (
    *_product((c.DRY,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.VISCOUS,), (*_FORCES, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.SQUARE, c.ROOT, *c.BY_PRESSURE, c.BY_DIFFERENCE), _FORCES),
    *_product((c.CONSTANT_FORCE,), (*_FORCES, *m.BEYOND_SPEED, m.FILM)),
    *_product((c.LOAD_DRY, c.LOAD_VISCOUS), (m.ALWAYS, *_LOADS, *m.BEYOND_SPEED, m.LEVELLING, m.FILM)),
    *_product((c.LOAD_SQUARE, c.LOAD_RUBBING), (m.ALWAYS, *_LOADS)),
    *_product((c.LOAD_SPRING, c.LOAD_CONSTANT), _LOADS),
    *_product((c.LEAK, c.HOLE), _FLOWS),
    *_product(c.CHAMBERS, (m.ALWAYS, *_FLOWS)),
    *_product((c.NULL,), (*m.BEYOND_OPENING, *_SPOOL)),
    *_product((c.GAIN, c.CURVE), _SPOOL),
    *_product((c.THROTTLE, c.NARROWED), _EDGES),
    *_product(c.PICKED, (m.ALWAYS,)),
    *_product(c.DRIFTING, _DRIFTS),
)
"""All compositions, named laws among them."""


def compositions(named: Iterable[Law]) -> tuple[Law, ...]:
    """All compositions that no named law writes already."""
    known = {(law.equation, law.where, law.text) for law in named}
    return tuple(law for law in EVERY if (law.equation, law.where, law.text) not in known)
