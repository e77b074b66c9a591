# SPDX-License-Identifier: Apache-2.0
"""Grown effects (`hydro_sim.model.effects.grown`) as causes that can be claimed: laws with ids, fitted as closures are.

A grown effect acts in the hooks in which the closure of its law acts, and in no other.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from hydro_diagnosis.effects.base import Effect, FitParameter, Values
from hydro_diagnosis.effects.closure import Closure, closure
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import grown
from hydro_sim.model.effects.closure import NamedLaw

SMALLEST = 0.01
"""Smallest coefficient worth claiming, as a share of what was seen."""
SYSTEMATIC = 0.01
"""Relative error of a law's further number that the residuals' own discretisation may cause."""
_FAMILIES = {"motion": "friction", "load": "spring", "actuation": "valve", "sensor": ""}
_DELEGATED = ("equations", "blocks", "nonlinear_channel", "places", "memoryless", "uses_acceleration")
"""Properties of the closure of a law that are the effect's."""
_HOOKS = ("command", "inflows", "resistance", "load", "inertia", "trace", "measure", "unmeasure")


@dataclass(frozen=True)
class Grown(Effect):
    """A law with an id; its subclasses, one for each, act where the law does."""

    named_law: NamedLaw | None = None
    term: Closure = Closure()  # noqa: RUF009 - frozen

    @property
    def _law(self) -> NamedLaw:
        assert self.named_law is not None
        return self.named_law

    @property
    def family(self) -> str:  # type: ignore[override]
        """That of the effects of the table which act in the same equation."""
        return _FAMILIES.get(self._law.law.equation, "leak")

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        bounds, seen = self._law.bounds, self._law.typical_parameters
        return tuple(
            replace(
                one, low=bounds[one.name][0], high=bounds[one.name][1], probes=(seen[one.name],), systematic=SYSTEMATIC,
                smallest=SMALLEST * abs(seen[one.name]) if one.smallest > 0.0 else 0.0,
            )
            for one in self.term.parameters
        )  # fmt: skip

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, term=replace(self.term, numbers=bench))

    def sentence(self, values: Values) -> str:
        law = self._law.law
        further = "".join(f", {one.name} {values[one.name]:.3g} {one.unit}" for one in law.numbers)
        return f"{law.sentence} It is {values['coefficient']:.3g} {law.unit} times {law.text}{further}."


def diagnosed(named: NamedLaw) -> Effect:
    """The effect in the diagnosis."""
    term = closure(named.law, Bench.nominal())
    term = replace(term, options={"id": named.id})  # what it remembers is kept under its own name
    acting = [hook for hook in _HOOKS if getattr(type(term), hook) is not getattr(Effect, hook)]
    about: dict[str, Any] = {hook: _handed(hook) for hook in acting}
    about |= {name: getattr(term, name) for name in _DELEGATED}
    made = type(named.id, (Grown,), {**about, "id": named.id, "stage": term.stage, "__doc__": named.law.sentence})
    return made(named_law=named, term=term)


def _handed(hook: str) -> Callable[..., Any]:
    def handed(self: Grown, *given: Any) -> Any:
        return getattr(self.term, hook)(*given)

    return handed


EFFECTS: tuple[Effect, ...] = tuple(map(diagnosed, grown.EFFECTS))
