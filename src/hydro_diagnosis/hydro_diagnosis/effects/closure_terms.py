# SPDX-License-Identifier: Apache-2.0
"""Laws and tables of `hydro_sim.model.grammar` as effects: fitted and simulated like named causes, but never named."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np

from hydro_diagnosis.effects import substeps
from hydro_diagnosis.effects.base import (
    LOAD,
    MOTION,
    PRESSURE,
    Effect,
    FitParameter,
    FloatArray,
    Kinematics,
    Memory,
    Oil,
    Values,
)
from hydro_diagnosis.effects.path_memory import along, held_lag, limited
from hydro_diagnosis.effects.sensors import TOUCHES
from hydro_diagnosis.effects.splines import splined
from hydro_sim.model import grammar
from hydro_sim.model.bench import Bench
from hydro_sim.model.edge_laws import edge_losses, shifted
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import TURN, WIDEST, Element, Law, Number
from hydro_sim.model.tables import SETTLING, Table

_TOUCHES = {"motion": frozenset({MOTION}), "load": frozenset({MOTION, LOAD})}
_EQUATIONS = {"pressure": ("pressure_a", "pressure_b")}
_REACH = 1e4
"""Bound of a coefficient, as a multiple of its typical size."""


@dataclass(frozen=True)
class Closure(Effect):
    """A term of one equation; `options` say which."""

    law: Law | Table = grammar.LAWS[0]
    limits: tuple[float, float] = (0.0, 1.0)
    """Limits of a table's variable or of a law's threshold, SI unit."""
    probes: tuple[float, ...] = ()
    """Start values of a threshold, within the limits."""
    numbers: Bench | None = None
    """The bench, once it is adapted."""

    id = "closure"
    named = False

    @property
    def touches(self) -> frozenset[str]:  # type: ignore[override]
        if self.law.equation == "sensor":
            return TOUCHES[self.law.where]
        return _TOUCHES.get(self.law.equation, frozenset({PRESSURE}))

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return _EQUATIONS.get(self.law.equation, (self.law.equation,))

    @property
    def family(self) -> str:  # type: ignore[override]
        """Laws of flows cannot pass for an error in the form of a law of forces."""
        flows = self.law.equation in ("actuation", "pressure", "pressure_a", "pressure_b")
        if self.law.equation == "sensor":
            flows = self.law.where.startswith("pressure")
        return "closure of flows" if flows else "closure of forces"

    @property
    def instant(self) -> bool:
        return self.element is None or self.element.kind in ("path", "slow")

    @property
    def shaken(self) -> bool:
        return "acceleration" in self.law.uses

    @property
    def element(self) -> Element | None:
        """Memory element of the term."""
        return self.law.element

    @cached_property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        law, size = self.law, self.law.typical
        names = ("coefficient",) if isinstance(law, Law) else law.names[2:]
        reach = _REACH * size
        amplitudes = tuple(
            FitParameter(
                name=name, unit=law.unit, low=-reach, high=reach, neutral=0.0, probes=(size,), smallest=1e-3 * size
            )
            for name in names
        )
        return (*amplitudes, *(self._number(one) for one in self._numbers))

    @property
    def _numbers(self) -> tuple[Number, ...]:
        """The law's further numbers."""
        return self.law.numbers if isinstance(self.law, Law) else ()

    def _number(self, number: Number) -> FitParameter:
        probes = self.probes if number.over and self.probes else number.probes
        low, high = self.limits if number.over and self.probes else number.bounds
        return FitParameter(
            name=number.name, unit=number.unit, low=low, high=high, neutral=probes[len(probes) // 2], probes=probes,
            systematic=0.6 if number.name == TURN.name else 0.01,  # the recorded velocity is a smoothed one
        )  # fmt: skip

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, numbers=bench)

    def nothing(self) -> list[dict[str, float]]:
        """Values at which the term vanishes: one set for each choice of start values of its further numbers."""
        still = {one.name: 0.0 for one in self.parameters}
        shapes = [one for one in self.parameters if one.smallest == 0.0]
        choices = product(*(one.probes for one in shapes))
        return [{**still, **dict(zip((one.name for one in shapes), chosen, strict=True))} for chosen in choices]

    def to_closure(self, values: Values) -> dict[str, Any]:
        """Return the entry under `closures` in corrected.yaml."""
        bounds = {} if isinstance(self.law, Law) else dict(zip(("low", "high"), self.limits, strict=True))
        return {"equation": self.law.equation, "form": self.law.form, "parameters": {**bounds, **values}}

    def sentence(self, values: Values) -> str:
        if isinstance(self.law, Law):
            return self.law.sentence
        over, factor = self.law.variable.replace("_", " "), self.law.factor
        what = f"A coefficient of the {factor.name} that follows" if factor else "A smooth function of"
        return f"{what} the {over}, for which no law was found."

    def _remembering(self, at: Signals, memory: Memory, values: Values) -> Signals:
        """The signals with what the law remembers of them."""
        element = self.element
        if element is None:
            return at
        if element.kind == "slow":
            at = at.but(number=values.get("threshold", 0.0))
            return at.but(memory=memory.lag(self.label, self._driver(at), values.get("time", SETTLING), 0.0))
        signal = getattr(at, element.signal)
        if element.kind == "lag":
            return at.but(memory=memory.lag(self.label, signal, values["time"]))
        if element.kind == "turn":
            late = memory.lag(self.label, signal, values["rising"], falling=values["falling"])
            return at.but(memory=late)
        if element.kind == "heat":
            work = np.abs(at.velocity) * (values["time"] / values["path"])
            return at.but(memory=memory.lag(self.label, work, values["time"], 0.0))
        return at.but(memory=memory.bristle(self.label, signal, 1.0 / values["path"], np.ones_like(signal)))

    def _driver(self, at: Signals) -> FloatArray:
        """What a slow state follows."""
        signal = self.element.signal if self.element else ""
        if signal != "time":
            return np.asarray(getattr(at, signal))
        return np.ones(np.broadcast_shapes(*(np.shape(one) for one in (at.position, at.current, at.force))))

    def given(self, at: Signals, values: Values, bench: Bench | None = None) -> FloatArray:
        """Value of the term, in the unit of its equation."""
        if isinstance(self.law, Law):
            return np.asarray(self.law.value(at, bench or self.numbers, [*values.values()]))
        given = splined(np.asarray(self.law.over(at)), *self.limits, np.array([*values.values()]))
        return np.asarray(given * self.law.factor.shape(at) if self.law.factor else given)


class MotionClosure(Closure):
    """A force against the motion."""

    adds = True

    def resistance(self, force: FloatArray, level: FloatArray, motion: Kinematics, memory: Memory,
                   values: Values) -> FloatArray:  # fmt: skip
        nothing = np.zeros_like(motion.position)
        at = Signals(motion.position, motion.velocity, *(motion.pressures or (nothing, nothing)))
        return force + self.given(self._remembering(at, memory, values), values)


class FlowClosure(Closure):
    """A flow out of the chambers beside the valve."""

    adds = True

    def trace(self, motion: Kinematics, memory: Memory, values: Values) -> None:
        """Flows are computed in the middle of each sample."""
        if self.element is not None and self.element.kind == "path":
            self._remembering(Signals(motion.position, motion.velocity), memory, values)

    def inflows(self, flows: tuple[FloatArray, FloatArray], oil: Oil, memory: Memory,
                values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        at = Signals(oil.position, oil.velocity, *oil.pressures, substeps.mean(oil.spool))
        out = self.given(self._remembering(at, memory, values), values, self.numbers)
        by_a, by_b = {"pressure": (-1.0, 1.0), "pressure_a": (-1.0, 0.0), "pressure_b": (0.0, -1.0)}[self.law.equation]
        return flows[0] + by_a * out, flows[1] + by_b * out


class EdgeClosure(Closure):
    """A share of the flow through the valve's edges that does not pass."""

    adds = True

    def inflows(self, flows: tuple[FloatArray, FloatArray], oil: Oil, memory: Memory,
                values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        bench = self.numbers
        assert bench is not None
        opened, closed = (substeps.mean_beyond(oil.spool, sign) for sign in (1.0, -1.0))
        openings = bench.valve_gain * opened, bench.valve_gain * closed
        past = self._remembering(Signals(current=substeps.mean(oil.spool)), memory, values).memory
        lost = edge_losses(bench, openings, oil.pressures, lambda at: self.given(at.but(memory=past), values))
        return flows[0] - lost[0], flows[1] - lost[1]


class AcrossClosure(Closure):
    """A shift of the spool at the edges, by the pressures across the valve and what moves it."""

    def inflows(self, flows: tuple[FloatArray, FloatArray], oil: Oil, memory: Memory,
                values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        spool = substeps.mean(oil.spool)
        at = Signals(oil.position, oil.velocity, *oil.pressures, spool)
        lost = shifted(self.numbers, spool, self.given(at, values), oil.pressures)
        return flows[0] - lost[0], flows[1] - lost[1]


class LoadClosure(Closure):
    """A force of the load."""

    adds = True

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        at = Signals(motion.position, motion.velocity)
        return force + self.given(self._remembering(at, memory, values), values, bench)


class DraggedClosure(LoadClosure):
    """A mass that the load drags along."""

    def load(self, force: FloatArray, motion: Kinematics, bench: Bench, memory: Memory, values: Values) -> FloatArray:
        if motion.acceleration is None:  # it is being computed: see `inertia`
            return force
        return force + motion.acceleration * self.inertia(motion, bench, values)

    def inertia(self, motion: Kinematics, bench: Bench, values: Values) -> FloatArray:
        return self.given(Signals(motion.position, motion.velocity, acceleration=1.0), values, bench)


class ValveClosure(Closure):
    """A term of the spool's position."""

    stage = 2

    def command(self, spool: FloatArray, substep: float, values: Values) -> FloatArray:
        at, path = Signals(current=spool), np.ascontiguousarray(spool).ravel()
        if self.element is not None and self.element.kind == "path":
            at = at.but(memory=along(path, 1.0 / values["path"], np.ones_like(path)).reshape(spool.shape))
        elif self.element is not None and self.element.kind == "slow":
            warm = held_lag(self._driver(at).ravel(), substep, values.get("time", SETTLING), 0.0)[1]
            at = at.but(memory=warm.reshape(spool.shape))
        elif self.element is not None:
            rising, falling = (values.get(name, values.get("time", 0.0)) for name in ("rising", "falling"))
            late = limited(path, substep, values.get("rate", WIDEST), rising, falling)
            at = at.but(memory=late.reshape(spool.shape))
        return spool + self.given(at, values)
