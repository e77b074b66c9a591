# SPDX-License-Identifier: Apache-2.0
"""Library of the diagnosis's causes: every effect of the bench model whose parameters have fit settings.

To add an effect, write its class in `hydro_sim.model.effects`; one with memory also needs its response to a whole
record (`dynamics`).
"""

from __future__ import annotations

from typing import Any

from hydro_diagnosis.effects.base import Effect, EffectHypothesis, FitParameter
from hydro_diagnosis.effects.dynamics import EFFECT_CLASSES, Stribeck, StribeckExponential
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects.base import fit, parameter
from hydro_sim.model.effects.catalogue import CATALOGUE, Kind
from hydro_sim.model.effects.friction import FrictionStribeck
from hydro_sim.model.effects.parameter_corrections import Correction

NOMINAL_BENCH = Bench.nominal()


_TABLE = [EFFECT_CLASSES.get(kind.effect, Effect)(kind).adapted(NOMINAL_BENCH) for kind in CATALOGUE.values()]
LIBRARY: tuple[Effect, ...] = tuple(one for one in _TABLE if one.parameters)
"""Effects that can be claimed; several may share an id (chambers, sensors, forms of one cause)."""
Stribeck.other_forms = (StribeckExponential(Kind(FrictionStribeck, (("form", "exponential"),))).adapted(NOMINAL_BENCH),)


class _WideningHoses(Correction):
    """Compliance of the hoses, the same in both chambers: V_dead plus compliance (beta + p).

    A wrong bulk modulus softens a chamber by a share of its volume, which the piston changes and which differs between
    the chambers; hoses soften both by the same amount. Merritt 1967, section 2-6.
    """

    id = "hoses_that_widen"
    sentence_template = "It looks like hoses that widen, by {compliance:.3g} m3/Pa in each chamber."
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    compliance = parameter("m3/Pa", 0.0, 1e-12, scale=1e-14, fit=fit(1e-14, smallest_reported=6e-16))

    def correct(self, n: Any) -> None:
        more = self.compliance * (n.bulk_modulus + 5e6)  # Pa, a typical pressure
        n.dead_volume_a, n.dead_volume_b = n.dead_volume_a + more, n.dead_volume_b + more


class Unnamed(Effect):
    """Candidate cause of the search without a name in the table: never claimed."""

    named = False


CANDIDATES = (*LIBRARY, Unnamed(Kind(_WideningHoses, ())).adapted(NOMINAL_BENCH))
"""Candidate effects of a search. One without a name that explains the recordings best is reported as a resemblance of
an unknown cause, not as a claim."""

__all__ = ["CANDIDATES", "LIBRARY", "EffectHypothesis", "Effect", "FitParameter"]
