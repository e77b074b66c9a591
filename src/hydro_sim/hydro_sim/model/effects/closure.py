# SPDX-License-Identifier: Apache-2.0
"""Closures: unnamed terms found by a diagnosis, as laws and tables of `model.grammar`."""

from __future__ import annotations

from typing import Any

from hydro_sim.model import grammar, laws, tables
from hydro_sim.model.effects import closure_memory as memory
from hydro_sim.model.effects import closure_terms as terms
from hydro_sim.model.effects.base import hidden, parameter
from hydro_sim.model.effects.closure_terms import Closure
from hydro_sim.model.laws import Element, Law, Number
from hydro_sim.model.tables import Table

_REACH = 1e4
"""Bound of a coefficient, as a multiple of its typical size."""
_SCALES = {"m": 1e-2, "m/s2": 5.0, "A": 1e-3, "Pa": 1e6, "N": 100.0, "m/s": 0.05, "A2": 1e-6, "-": 1.0}


def made(law: Law | Table) -> type[Closure]:
    """The class of closures of a law or table."""
    reach = _REACH * law.typical
    members: dict[str, Any] = {name: parameter(law.unit, -reach, reach, scale=law.typical) for name in law.names}
    element = law.element
    if isinstance(law, Table):
        members |= {} if element is None else {"time": tables.SETTLING}
        over = tables.VARIABLES[law.variable]
        members |= {name: parameter(over, -laws.WIDEST, laws.WIDEST, scale=1.0) for name in ("low", "high")}
    else:
        members |= {one.name: _number(one) for one in law.numbers}
    if element is not None:
        members |= {**_states(element, law), "element": element}
    elif law.picks_up:
        members |= {"held": hidden("A", scale=1e-3)}
    about = {"law": law, "options": {"equation": (law.equation,), "form": (law.form,)}, "__doc__": Closure.__doc__}
    return type("Closure", _bases(law, element), {**about, **members})


def _number(number: Number) -> dict[str, Any]:
    """A law's further number."""
    middle = number.probes[len(number.probes) // 2]
    return parameter(number.unit, *number.bounds, scale=abs(middle), neutral=middle)


def _states(element: Element, law: Law | Table) -> dict[str, Any]:
    """An element's hidden states."""
    unit, scale = element.signal_unit, _SCALES[element.signal_unit]
    where, past = {"where": hidden(unit, scale=scale)}, {"past": hidden(unit, scale=scale, integrated=True)}
    spool = law.equation == "actuation" and not law.where
    return {
        "lag": where if spool else past,
        "turn": where if spool else past,
        "heat": {"past": hidden("-", scale=1.0, integrated=True)},
        "path": {"bent": hidden("-", scale=1.0), **where},
        "rate": where,
        "slow": {"past": hidden(unit, scale=scale, integrated=not spool)},
    }[element.kind]


_PLACES = {"edges": terms.EdgeClosure, "across": terms.AcrossClosure}
_MEMORIES = {
    "lag": memory.Lagging,
    "heat": memory.Warming,
    "path": memory.Bending,
    "slow": memory.Following,
    "turn": memory.Turning,
}
_AT_SPOOL = {"rate": memory.Limited, "slow": memory.Settling, "turn": memory.TurningSpool,
             "lag": memory.LaggingSpool}  # fmt: skip
"""What a spool, which is held over a step, remembers otherwise."""


def _bases(law: Law | Table, element: Element | None) -> tuple[type[Closure], ...]:
    acting = {
        "motion": terms.MotionClosure,
        "load": terms.LoadClosure,
        "sensor": terms.SensorClosure,
        "actuation": terms.ValveClosure,
    }
    acts = _PLACES.get(law.where) or acting.get(law.equation, terms.FlowClosure)
    if "acceleration" in law.uses:
        return (terms.Shaken,) if law.equation == "sensor" else (terms.DraggedClosure,)
    if element is None:
        return (terms.PickingUp,) if law.picks_up else (acts,)
    remembers = _AT_SPOOL.get(element.kind) if acts is terms.ValveClosure else None
    return remembers or _MEMORIES[element.kind], acts


EFFECTS = tuple(made(law) for law in grammar.ALL.values())
