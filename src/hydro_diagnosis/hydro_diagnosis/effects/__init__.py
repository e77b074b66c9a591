# SPDX-License-Identifier: Apache-2.0
"""Causes of the diagnosis: every effect of the bench model that says how it is fitted; `LIBRARY` holds them.

To add an effect, write its class in `hydro_sim.model.effects`; one with memory also says here how a whole record passes
it (`dynamics`). Laws that were found on several benches are added by `diagnose --grow`.
"""

from __future__ import annotations

from typing import Any

from hydro_diagnosis.effects.base import Claim, Effect, FitParameter
from hydro_diagnosis.effects.closure import grown_cause
from hydro_diagnosis.effects.dynamics import CLASSES, Stribeck, StribeckExponential
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import grown
from hydro_sim.model.effects.base import fit, parameter
from hydro_sim.model.effects.catalogue import CATALOGUE, Kind
from hydro_sim.model.effects.friction import FrictionStribeck
from hydro_sim.model.effects.numbers import Correction

NOMINAL = Bench.nominal()


_TABLE = [CLASSES.get(kind.effect, Effect)(kind).adapted(NOMINAL) for kind in CATALOGUE.values()]
LIBRARY: tuple[Effect, ...] = (
    *(one for one in _TABLE if one.parameters and one.id not in grown.IDS),
    *map(grown_cause, grown.EFFECTS),
)
"""Effects that can be claimed; several may share an id (chambers, sensors, forms of one cause)."""
_EXPONENTIAL = Kind(FrictionStribeck, (("form", "exponential"),))
Stribeck.other_forms = (StribeckExponential(_EXPONENTIAL).adapted(NOMINAL),)


class _WideningHoses(Correction):
    """Both chambers grow by the same volume per pressure: V_dead plus compliance (beta + p).

    A wrong bulk modulus softens a chamber by a share of its volume, which the piston changes and which differs between
    the chambers; hoses soften both by the same amount. Merritt 1967, section 2-6.
    """

    id = "hoses_that_widen"
    says = "It looks like hoses that widen, by {compliance:.3g} m3/Pa in each chamber."
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    compliance = parameter("m3/Pa", 0.0, 1e-12, scale=1e-14, fit=fit(1e-14, smallest=6e-16))

    def correct(self, n: Any) -> None:
        more = self.compliance * (n.bulk_modulus + 5e6)  # Pa, a typical pressure
        n.dead_volume_a, n.dead_volume_b = n.dead_volume_a + more, n.dead_volume_b + more


class Unnamed(Effect):
    """A cause that is tried like all others, but never claimed."""

    named = False


CANDIDATES = (*LIBRARY, Unnamed(Kind(_WideningHoses, ())).adapted(NOMINAL))
"""Effects that a search tries. Where one without a name explains the recordings best, the verdict is an unnamed cause,
with what it resembles."""

__all__ = ["CANDIDATES", "LIBRARY", "Claim", "Effect", "FitParameter"]
