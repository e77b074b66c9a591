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

RATIO = FitParameter(name="ratio", unit="-", low=0.3, high=3.0, neutral=1.0, probes=(0.95,), smallest=0.003)


class _Times(Effect):
    """A number of the bench file times a ratio."""

    number: ClassVar[str]
    """In bench.yaml."""
    words: ClassVar[str]
    says = "The {effect.words} is {ratio:.4g} times what the bench file says."

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, **{self.number: getattr(bench, self.number) * values["ratio"]})


def times(
    identifier: str, words: str, equations: str, blocks: frozenset[str], number: str = "", *, chamber: str = "",
    ratio: FitParameter = RATIO, **more: str,
) -> Effect:  # fmt: skip
    """The effect that a number of the bench file, of the id's name if none is given, is wrong by a ratio.

    `words`: the number in words. `equations`, `blocks`: in which it acts. `chamber`: whose it is, if one has it alone.
    """
    about = {"id": identifier, "number": number or identifier, "words": words, "parameters": (ratio,), **more}
    made: type[Effect] = type(identifier, (_Times,), {**about, "equations": tuple(equations.split()), "blocks": blocks})
    return made({"chamber": chamber} if chamber else {})


class TrueValue(Effect):
    """The true value of the number of the bench file that the effect refers to."""

    number: ClassVar[FitParameter]
    """Its probe is the distance from the bench file's value."""

    @property
    def parameters(self) -> tuple[FitParameter, ...]:  # type: ignore[override]
        true, (apart,) = self.reference, self.number.probes
        return (replace(self.number, neutral=true, probes=(true + apart,)),)

    def bench(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, **{self.refers: values[self.number.name]})


class TankPressure(TrueValue):
    """The true p_t."""

    id = "tank_pressure"
    refers = "tank_pressure"
    equations = ("actuation",)
    blocks = frozenset({PRESSURE})
    number = FitParameter(name="pressure", unit="Pa", low=0.0, high=5e6, probes=(2e5,), smallest=1e4)

    def sentence(self, values: Values) -> str:
        return f"The tank stands at {values['pressure'] * 1e-6:.3g} MPa, not at what the bench file says."


_DEAD = replace(RATIO, low=0.1, high=10.0, smallest=0.004)
_PISTON = frozenset({PRESSURE, MOTION, HYDRAULIC})
EFFECTS: tuple[Effect, ...] = (
    times("supply_pressure", "supply pressure", "actuation", frozenset({PRESSURE})),
    times("piston_area", "piston area", "pressure_a pressure_b", _PISTON),  # of both chambers: A_b = alpha A_p
    times("area_ratio", "ratio of the piston areas", "pressure_b", _PISTON),
    *(times("dead_volume", f"dead volume of chamber {chamber.upper()}", f"pressure_{chamber}", frozenset({PRESSURE}),
            f"dead_volume_{chamber}", chamber=chamber, ratio=_DEAD) for chamber in "ab"),
    TankPressure(),
)  # fmt: skip


_PRESSURE = 5e6
"""Typical pressure [Pa] of the chambers: over the bulk modulus, the additional oil that a wider hose holds."""


class WideningHoses(Effect):
    """Both chambers grow by the same volume per pressure: V_dead plus compliance (beta + p).

    A wrong bulk modulus softens a chamber by a share of its volume, which the piston changes and which differs between
    the chambers; hoses soften both by the same amount. Merritt 1967, section 2-6.
    """

    id = "hoses_that_widen"
    says = "It looks like hoses that widen, by {compliance:.3g} m3/Pa in each chamber."
    named = False
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    blocks = frozenset({PRESSURE})
    parameters = (FitParameter(name="compliance", unit="m3/Pa", low=0.0, high=1e-12, probes=(1e-14,), smallest=6e-16),)

    def bench(self, bench: Bench, values: Values) -> Bench:
        more = values["compliance"] * (bench.bulk_modulus + _PRESSURE)
        return changed(bench, dead_volume_a=bench.dead_volume_a + more, dead_volume_b=bench.dead_volume_b + more)


UNNAMED: tuple[Effect, ...] = (WideningHoses(),)
