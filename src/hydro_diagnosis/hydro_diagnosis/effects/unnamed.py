# SPDX-License-Identifier: Apache-2.0
"""Unnamed causes that resemble a named one: tried like all others, but never claimed.

Where one of them explains the recordings best, the verdict is an unnamed cause, with what it resembles.
"""

from __future__ import annotations

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, Values, changed
from hydro_sim.model.bench import Bench

_LEVEL = 5e6
"""Typical pressure [Pa] of the chambers: over the bulk modulus, the additional oil that a wider hose holds."""


class WideningHoses(Effect):
    """Both chambers grow by the same volume per pressure: V_dead plus compliance (beta + p).

    A wrong bulk modulus softens a chamber by a share of its volume, which the piston changes and which differs between
    the chambers; hoses soften both by the same amount. Merritt 1967, section 2-6.
    """

    id = "hoses_that_widen"
    named = False
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    touches = frozenset({PRESSURE})
    parameters = (
        FitParameter(
            name="compliance", unit="m3/Pa", low=0.0, high=1e-12, neutral=0.0, probes=(1e-14,), smallest=6e-16
        ),
    )

    def bench(self, bench: Bench, values: Values) -> Bench:
        more = values["compliance"] * (bench.bulk_modulus + _LEVEL)
        return changed(bench, dead_volume_a=bench.dead_volume_a + more, dead_volume_b=bench.dead_volume_b + more)

    def sentence(self, values: Values) -> str:
        return f"It looks like hoses that widen, by {values['compliance']:.3g} m3/Pa in each chamber."


EFFECTS: tuple[Effect, ...] = (WideningHoses(),)
