# SPDX-License-Identifier: Apache-2.0
"""Laws with an id: effects that were grown from what diagnoses found on several benches (`model.effects.grown`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

from hydro_sim.model.effects import closure
from hydro_sim.model.effects.base import Effect
from hydro_sim.model.laws import Law


@dataclass(frozen=True, kw_only=True)
class NamedLaw:
    """One effect of the bench: a law, its id, and the bounds of its parameters."""

    id: str
    law: Law
    """Its typical coefficient and the probes of its further numbers are those that were seen."""
    bounds: Mapping[str, tuple[float, float]]
    """Lowest and highest value of each parameter, in the law's units."""

    def __post_init__(self) -> None:
        if tuple(self.bounds) != self.law.names:
            raise ValueError(f"effect {self.id}: bounds are of {', '.join(self.law.names)}, in this order")

    @property
    def seen(self) -> dict[str, float]:
        """Typical values of its parameters."""
        sign = 1.0 if self.bounds["coefficient"][1] > 0.0 else -1.0
        middles = {number.name: number.probes[len(number.probes) // 2] for number in self.law.numbers}
        return {"coefficient": sign * self.law.typical, **middles}


def simulated(named: NamedLaw) -> type[Effect]:
    """The effect in the bench model: it does what the closure of its law does."""
    acting = closure.made(named.law)
    about = {"id": named.id, "options": {}, "__doc__": named.law.sentence}
    effect: Any = type(named.id, (acting,), about)
    effect.parameters = tuple(
        replace(one, low=named.bounds[one.name][0], high=named.bounds[one.name][1]) for one in acting.parameters
    )
    return effect
