# SPDX-License-Identifier: Apache-2.0
"""Leakage between the chambers and out of a chamber."""

from __future__ import annotations

import numpy as np

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Values

_COEFFICIENT = FitParameter(
    name="coefficient", unit="m3/s/Pa", low=0.0, high=1e-10, neutral=0.0, probes=(1e-13,), smallest=1e-15
)


MEETING_POINT = 5e6
"""Pressure drop [Pa] at which leaks of all forms pass as much as the laminar one: the middle of a seal's range."""


class LeakageInternal(Effect):
    """q = c (p_a - p_b) past the piston seal, laminar."""

    id = "leakage_internal"
    family = "leak"
    equations = ("pressure_a", "pressure_b")
    touches = frozenset({PRESSURE})
    parameters = (_COEFFICIENT,)

    def flows(self, flows: tuple[FloatArray, FloatArray], pressures: tuple[FloatArray, FloatArray], tank: float,
              values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        leak = values["coefficient"] * (pressures[0] - pressures[1])
        return flows[0] - leak, flows[1] + leak

    def sentence(self, values: Values) -> str:
        return f"Oil leaks past the piston between the chambers, {values['coefficient'] * 1e12:.3g} ml/s per MPa."


class LeakageInternalOrifice(LeakageInternal):
    """q = c sqrt(|dp| p_1) sign(dp) through a sharp edge; as much as a laminar leak of the same c at dp = p_1."""

    def flows(self, flows: tuple[FloatArray, FloatArray], pressures: tuple[FloatArray, FloatArray], tank: float,
              values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
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
    touches = frozenset({PRESSURE})
    parameters = (_COEFFICIENT,)

    @property
    def equations(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("pressure_" + self.options["chamber"],)

    def flows(self, flows: tuple[FloatArray, FloatArray], pressures: tuple[FloatArray, FloatArray], tank: float,
              values: Values) -> tuple[FloatArray, FloatArray]:  # fmt: skip
        if self.options["chamber"] == "a":
            return flows[0] - values["coefficient"] * (pressures[0] - tank), flows[1]
        return flows[0], flows[1] - values["coefficient"] * (pressures[1] - tank)

    def sentence(self, values: Values) -> str:
        return (
            f"Chamber {self.options['chamber'].upper()} leaks to the tank, "
            f"{values['coefficient'] * 1e12:.3g} ml/s per MPa."
        )


EFFECTS: tuple[Effect, ...] = (
    LeakageInternal(),
    LeakageInternalOrifice({"form": "orifice"}),
    LeakageExternal({"chamber": "a"}),
    LeakageExternal({"chamber": "b"}),
)
