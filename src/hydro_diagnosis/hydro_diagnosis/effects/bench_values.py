# SPDX-License-Identifier: Apache-2.0
"""Wrong values in the bench file (geometry and pressures), and unnamed causes that resemble them.

Unnamed causes are tried like all others, but never claimed: where one of them explains the recordings best, the verdict
is an unnamed cause, with what it resembles.
"""

from __future__ import annotations

from dataclasses import replace
from typing import ClassVar

from hydro_diagnosis.effects.base import HYDRAULIC, MOTION, PRESSURE, Effect, FitParameter, Values, changed
from hydro_sim.model.bench import Bench

_RATIO = FitParameter(name="ratio", unit="-", low=0.3, high=3.0, neutral=1.0, probes=(0.95,), smallest=0.003)


class _Times(Effect):
    """A number of the bench file times a ratio."""

    number: ClassVar[str]
    """In bench.yaml."""
    words: ClassVar[str]
    parameters = (_RATIO,)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, **{self.number: getattr(bench, self.number) * values["ratio"]})

    def sentence(self, values: Values) -> str:
        return f"The {self.words} is {values['ratio']:.4g} times what the bench file says."


class SupplyPressure(_Times):
    """p_s times a ratio."""

    id = "supply_pressure"
    equations = ("actuation",)
    blocks = frozenset({PRESSURE})
    number, words = "supply_pressure", "supply pressure"


class PistonArea(_Times):
    """A_p times a ratio: of both chambers, since A_b = alpha A_p."""

    id = "piston_area"
    equations = ("pressure_a", "pressure_b")
    blocks = frozenset({PRESSURE, MOTION, HYDRAULIC})
    number, words = "piston_area", "piston area"


class AreaRatio(_Times):
    """alpha times a ratio."""

    id = "area_ratio"
    equations = ("pressure_b",)
    blocks = frozenset({PRESSURE, MOTION, HYDRAULIC})
    number, words = "area_ratio", "ratio of the piston areas"


class DeadVolumeA(_Times):
    """V_dead of chamber A times a ratio."""

    id = "dead_volume"
    equations = ("pressure_a",)
    blocks = frozenset({PRESSURE})
    parameters = (replace(_RATIO, low=0.1, high=10.0, smallest=0.004),)
    number, words = "dead_volume_a", "dead volume of chamber A"


class DeadVolumeB(DeadVolumeA):
    """V_dead of chamber B times a ratio."""

    equations = ("pressure_b",)
    number, words = "dead_volume_b", "dead volume of chamber B"


class TankPressure(Effect):
    """The true p_t."""

    id = "tank_pressure"
    equations = ("actuation",)
    blocks = frozenset({PRESSURE})

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        true = self.reference
        return (FitParameter(name="pressure", unit="Pa", low=0.0, high=5e6, neutral=true, probes=(true + 2e5,),
                             smallest=1e4),)  # fmt: skip

    def adapted(self, bench: Bench) -> Effect:
        return replace(self, reference=bench.tank_pressure)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, tank_pressure=values["pressure"])

    def sentence(self, values: Values) -> str:
        return f"The tank stands at {values['pressure'] * 1e-6:.3g} MPa, not at what the bench file says."


EFFECTS: tuple[Effect, ...] = (
    SupplyPressure(),
    PistonArea(),
    AreaRatio(),
    DeadVolumeA({"chamber": "a"}),
    DeadVolumeB({"chamber": "b"}),
    TankPressure(),
)
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
    blocks = frozenset({PRESSURE})
    parameters = (FitParameter(name="compliance", unit="m3/Pa", low=0.0, high=1e-12, probes=(1e-14,), smallest=6e-16),)

    def bench(self, bench: Bench, values: Values) -> Bench:
        more = values["compliance"] * (bench.bulk_modulus + _LEVEL)
        return changed(bench, dead_volume_a=bench.dead_volume_a + more, dead_volume_b=bench.dead_volume_b + more)

    def sentence(self, values: Values) -> str:
        return f"It looks like hoses that widen, by {values['compliance']:.3g} m3/Pa in each chamber."


UNNAMED: tuple[Effect, ...] = (WideningHoses(),)
