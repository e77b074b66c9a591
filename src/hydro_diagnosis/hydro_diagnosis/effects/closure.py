# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.grammar` as effects, each of the class that acts in its equation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from hydro_diagnosis.effects.closure_sensors import GaugeClosure, PlaceClosure, SensorClosure, SnubberClosure
from hydro_diagnosis.effects.closure_terms import (
    AcrossClosure,
    Closure,
    DraggedClosure,
    EdgeClosure,
    FlowClosure,
    LoadClosure,
    MotionClosure,
    ValveClosure,
)
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.laws import Law
from hydro_sim.model.tables import Table

__all__ = [
    "AcrossClosure",
    "Closure",
    "DraggedClosure",
    "EdgeClosure",
    "FlowClosure",
    "GaugeClosure",
    "LoadClosure",
    "MotionClosure",
    "PlaceClosure",
    "SensorClosure",
    "SnubberClosure",
    "ValveClosure",
    "closure",
    "from_mapping",
]


def closure(
    law: Law | Table, bench: Bench, limits: tuple[float, float] = (0.0, 1.0), probes: tuple[float, ...] = ()
) -> Closure:
    """A law or table as an effect on a bench.

    `limits`: of a table's variable or of a law's threshold, SI unit; `probes`: start values of that threshold.
    """
    acting = {"motion": MotionClosure, "load": LoadClosure, "actuation": ValveClosure, "sensor": SensorClosure}
    placed = {"edges": EdgeClosure, "across": AcrossClosure, "piston_position": PlaceClosure}
    kind = placed.get(law.where) or acting.get(law.equation, FlowClosure)
    kind = GaugeClosure if law.where.startswith("pressure") else kind
    kind = DraggedClosure if kind is LoadClosure and "acceleration" in law.uses else kind
    if law.equation == "sensor" and law.element is not None and law.element.kind == "turn":
        kind = SnubberClosure
    options = {"equation": law.equation, "form": law.form}
    return kind(options, law=law, limits=limits, probes=probes, numbers=bench)


def from_mapping(entry: Mapping[str, Any], bench: Bench) -> tuple[Closure, dict[str, float]]:
    """An entry of `closures` in corrected.yaml, checked by `Bench`, as an effect with values."""
    law = grammar.ALL[entry["equation"], entry["form"]]
    numbers = {name: float(entry["parameters"][name]) for name in law.names}
    limits = (numbers.pop("low"), numbers.pop("high")) if isinstance(law, Table) else (0.0, 1.0)
    return closure(law, bench, limits), numbers
