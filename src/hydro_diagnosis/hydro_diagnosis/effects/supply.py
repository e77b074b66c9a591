# SPDX-License-Identifier: Apache-2.0
"""Supply droop: the supply pressure falls with the flow that is drawn."""

from __future__ import annotations

from hydro_diagnosis.effects.base import PRESSURE, Effect, FitParameter, FloatArray, Memory, Values


class SupplyDroop(Effect):
    """T p_d' + p_d = R q_s;  supply pressure p_s - p_d, q_s the flow drawn from it."""

    id = "supply_droop"
    equations = ("actuation",)
    touches = frozenset({PRESSURE})
    parameters = (
        FitParameter(name="resistance", unit="Pa s/m3", low=0.0, high=1e12, neutral=0.0, probes=(3e10,), smallest=1e9),
        FitParameter(name="time_constant", unit="s", low=1e-3, high=3.0, neutral=0.05, probes=(0.01, 0.05, 0.3)),
    )

    def supply(self, supply: FloatArray, demand: FloatArray, memory: Memory, values: Values) -> FloatArray:
        return supply - values["resistance"] * memory.lag("supply", demand, values["time_constant"])

    def sentence(self, values: Values) -> str:
        return (
            f"The supply pressure falls with the flow drawn, by {values['resistance'] * 1e-12:.3g} MPa per ml/s, "
            f"and recovers with a time constant of {values['time_constant'] * 1e3:.3g} ms."
        )


EFFECTS: tuple[Effect, ...] = (SupplyDroop(),)
