# SPDX-License-Identifier: Apache-2.0
"""Effects of the oil and its supply: leakage, supply droop, bulk modulus, entrained air."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Pair, Values, changed
from hydro_diagnosis.effects.memory import Memory
from hydro_sim.model.bench import Bench

_COEFFICIENT = FitParameter(name="coefficient", unit="m3/s/Pa", low=0.0, high=1e-10, probes=(1e-13,), smallest=1e-15)
MEETING_POINT = 5e6
"""Pressure drop [Pa] at which leaks of all forms pass as much as the laminar one: the middle of a seal's range."""


class LeakageInternal(Effect):
    """q = c (p_a - p_b) past the piston seal, laminar."""

    id = "leakage_internal"
    says = "Oil leaks past the piston between the chambers, {coefficient:.3g} ml/s per MPa."
    family = "leak"
    equations = ("pressure_a", "pressure_b")
    blocks = frozenset({PRESSURE})
    parameters = (_COEFFICIENT,)

    def flows(self, flows: Pair, pressures: Pair, tank: float, values: Values) -> Pair:
        leak = values["coefficient"] * (pressures[0] - pressures[1])
        return flows[0] - leak, flows[1] + leak


class LeakageInternalOrifice(LeakageInternal):
    """q = c sqrt(|dp| p_1) sign(dp) through a sharp edge; as much as a laminar leak of the same c at dp = p_1."""

    def flows(self, flows: Pair, pressures: Pair, tank: float, values: Values) -> Pair:
        drop = pressures[0] - pressures[1]
        leak = values["coefficient"] * np.copysign(np.sqrt(np.abs(drop) * MEETING_POINT), drop)
        return flows[0] - leak, flows[1] + leak

    def sentence(self, values: Values) -> str:
        return (
            "Oil leaks between the chambers as through a sharp edge, "
            f"{values['coefficient'] * 5e12:.3g} ml/s at 5 MPa between them."
        )


class LeakageExternal(Effect):
    """q = c (p - p_t) out of one chamber, laminar."""

    id = "leakage_external"
    family = "leak"
    blocks = frozenset({PRESSURE})
    parameters = (_COEFFICIENT,)

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("pressure_" + self.options["chamber"],)

    def flows(self, flows: Pair, pressures: Pair, tank: float, values: Values) -> Pair:
        if self.options["chamber"] == "a":
            return flows[0] - values["coefficient"] * (pressures[0] - tank), flows[1]
        return flows[0], flows[1] - values["coefficient"] * (pressures[1] - tank)

    def sentence(self, values: Values) -> str:
        return (
            f"Chamber {self.options['chamber'].upper()} leaks to the tank, "
            f"{values['coefficient'] * 1e12:.3g} ml/s per MPa."
        )


LEAKAGE: tuple[Effect, ...] = (
    LeakageInternal(),
    LeakageInternalOrifice({"form": "orifice"}),
    LeakageExternal({"chamber": "a"}),
    LeakageExternal({"chamber": "b"}),
)


class SupplyDroop(Effect):
    """T p_d' + p_d = R q_s;  supply pressure p_s - p_d, q_s the flow drawn from it."""

    id = "supply_droop"
    says = (
        "The supply pressure falls with the flow drawn, by {resistance:.3g} MPa per ml/s, and recovers with a "
        "time constant of {time_constant:.3g} ms."
    )
    equations = ("actuation",)
    blocks = frozenset({PRESSURE})
    parameters = (
        FitParameter(name="resistance", unit="Pa s/m3", low=0.0, high=1e12, probes=(3e10,), smallest=1e9),
        FitParameter(name="time_constant", unit="s", low=1e-3, high=3.0, neutral=0.05, probes=(0.01, 0.05, 0.3)),
    )

    def supply(self, supply: FloatArray, demand: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return supply - values["resistance"] * memory.lag("supply", demand, values["time_constant"])


ATMOSPHERE = 101325.0
"""Pa; `volume_fraction` is the share of free air at this pressure."""


class BulkModulus(Effect):
    """beta times a ratio."""

    id = "bulk_modulus"
    says = "The bulk modulus is {ratio:.4g} times what the bench file says, at every pressure."
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    blocks = frozenset({PRESSURE})
    parameters = (FitParameter(name="ratio", unit="-", low=0.2, high=5.0, neutral=1.0, probes=(0.9,), smallest=0.004),)

    def stiffness(self, modulus: FloatArray, pressure: FloatArray, values: Values) -> FloatArray:
        return modulus * values["ratio"]

    def settled(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, bulk_modulus=bench.bulk_modulus * values["ratio"])


class EntrainedAir(Effect):
    """Compliance of oil and of free air in series: 1/beta_e = (o/beta + g/(n p)) / (o + g).

    o = (1 - a) exp(-p/beta) and g = a (p_0/p)^(1/n) are the volumes of oil and air. Merritt 1967, section 2-6, with
    the exponent n of the air's compression: 1.4 adiabatic, 1.0 isothermal.
    """

    id = "entrained_air"
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    blocks = frozenset({PRESSURE})
    parameters = (
        FitParameter(name="volume_fraction", unit="-", low=0.0, high=0.3, probes=(0.003, 0.02), smallest=1e-4),
    )

    def stiffness(self, modulus: FloatArray, pressure: FloatArray, values: Values) -> FloatArray:
        exponent = 1.0 if self.options.get("form") == "isothermal" else 1.4
        share = values["volume_fraction"]
        absolute = np.maximum(pressure, 0.0) + ATMOSPHERE
        air = share * (ATMOSPHERE / absolute) ** (1.0 / exponent)
        oil = (1.0 - share) * np.exp(-np.maximum(pressure, 0.0) / modulus)
        return (oil + air) / (oil / modulus + air / (exponent * absolute))

    def sentence(self, values: Values) -> str:
        share = values["volume_fraction"] * 100.0
        return f"{share:.3g} % of free air (at atmospheric pressure) softens the oil where its pressure is low."


EFFECTS: tuple[Effect, ...] = (SupplyDroop(), BulkModulus(), EntrainedAir(), EntrainedAir({"form": "isothermal"}))
