# SPDX-License-Identifier: Apache-2.0
"""Effects of the oil: wrong bulk modulus, entrained air."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Values, changed
from hydro_sim.model.bench import Bench

ATMOSPHERE = 101325.0
"""Pa; `volume_fraction` is the share of free air at this pressure."""


class BulkModulus(Effect):
    """beta times a ratio."""

    id = "bulk_modulus"
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    touches = frozenset({PRESSURE})
    parameters = (FitParameter(name="ratio", unit="-", low=0.2, high=5.0, neutral=1.0, probes=(0.9,), smallest=0.004),)

    def stiffness(self, modulus: FloatArray, pressure: FloatArray, values: Values) -> FloatArray:
        return modulus * values["ratio"]

    def settled(self, bench: Bench, values: Values) -> Bench:
        return changed(bench, bulk_modulus=bench.bulk_modulus * values["ratio"])

    def sentence(self, values: Values) -> str:
        return f"The bulk modulus is {values['ratio']:.4g} times what the bench file says, at every pressure."


class EntrainedAir(Effect):
    """Compliance of oil and of free air in series: 1/beta_e = (o/beta + g/(n p)) / (o + g).

    o = (1 - a) exp(-p/beta) and g = a (p_0/p)^(1/n) are the volumes of oil and air. Merritt 1967, section 2-6, with
    the exponent n of the air's compression: 1.4 adiabatic, 1.0 isothermal.
    """

    id = "entrained_air"
    equations = ("pressure_a", "pressure_b")
    family = "oil"
    touches = frozenset({PRESSURE})
    parameters = (
        FitParameter(
            name="volume_fraction", unit="-", low=0.0, high=0.3, neutral=0.0, probes=(0.003, 0.02), smallest=1e-4
        ),
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


EFFECTS: tuple[Effect, ...] = (BulkModulus(), EntrainedAir(), EntrainedAir({"form": "isothermal"}))
