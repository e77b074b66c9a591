# SPDX-License-Identifier: Apache-2.0
"""Supply, leakage and stiffness of the oil. Source: Merritt 1967, sections 2-6 and 3-3."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from hydro_sim.model.effects.base import DRIFT_MAX, DRIFT_MIN, Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.equations import Symbol, clip, orifice

ORIFICE_REFERENCE_DROP = 5e6
"""Pressure drop [Pa] at which a leak through a sharp edge passes as much as a laminar one of the same coefficient."""
RETURN_REFERENCE_PRESSURE = 5e5
"""Pressure [Pa] at which the time constant of a return line behind an orifice is stated."""
LAMINAR_DROP = 1e3
"""Pressure drop [Pa] below which the flow through a line's orifice becomes proportional to the drop."""
RELIEF_TIME = 5e-4
"""Time [s] in which a relief valve takes off what exceeds its pressure."""
ATMOSPHERIC_PRESSURE = 101325.0
"""Pressure [Pa] at which the free air's volume fraction is stated."""

_CHAMBERS = "pressure_a", "pressure_b"
_LAMINAR = fit(1e-13, smallest_reported=1e-15, high=1e-10)


class SupplyDroop(Effect):
    """Droop p_d of the supply pressure by the flow q_s drawn, with a first-order lag: T p_d' + p_d = R q_s."""

    id = "supply_droop"
    equations = ("actuation",)
    sentence_template = (
        "The supply pressure falls with the flow drawn, by {resistance:.3g} MPa per ml/s, and recovers with a "
        "time constant of {time_constant:.3g} ms."
    )
    single = True
    resistance = parameter("Pa s/m3", 0.0, 1e12, scale=1e9, fit=fit(3e10, smallest_reported=1e9))
    time_constant = parameter("s", 1e-3, 100.0, scale=0.05, neutral=0.05, fit=fit(0.01, 0.05, 0.3, high=3.0))
    demand = hidden("m3/s", scale=1e-5, integrated=True)

    def supply(self, pressure: Symbol) -> Symbol:
        return pressure - self.resistance * self.demand

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"demand": (drawn - self.demand) / self.time_constant}


class _ReturnLine(Effect):
    id = "return_line"
    equations = ("actuation",)
    family = "return line"
    single = True


class ReturnLine(_ReturnLine):
    """Pressure p_r of the line to the tank by the flow q_t returned, with a first-order lag: T p_r' + p_r = R q_t.

    A volume V of oil behind a laminar resistance: T = R V / beta.
    """

    sentence_template = (
        "The pressure behind the valve's tank port rises with the flow returned, by {resistance:.3g} MPa per ml/s, and "
        "falls with a time constant of {time_constant:.3g} ms."
    )
    resistance = parameter("Pa s/m3", 0.0, 1e12, scale=1e9, fit=fit(3e10, smallest_reported=1e9))
    time_constant = parameter("s", 1e-3, 100.0, scale=0.05, neutral=0.05, fit=fit(3e-3, 0.02, 0.1, high=3.0))
    flow = hidden("m3/s", scale=1e-5, integrated=True)

    def tank(self, pressure: Symbol) -> Symbol:
        return pressure + self.resistance * self.flow

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        return {"flow": (self.at.returned - self.flow) / self.time_constant}


class ReturnLineOrifice(_ReturnLine):
    """Pressure p_r of the line to the tank, a volume V of oil behind an orifice: V / beta p_r' = q_t - K sqrt(p_r).

    Its time constant 2 V sqrt(p_r) / (beta K) is stated at `RETURN_REFERENCE_PRESSURE`.
    """

    options = {"form": ("orifice",)}
    sentence_template = (
        "The pressure behind the valve's tank port rises as behind an orifice that passes {orifice:.3g} ml/s at 1 MPa, "
        "and falls with a time constant of {time_constant:.3g} ms at 0.5 MPa."
    )
    orifice = parameter("m3/s/sqrt(Pa)", 1e-12, 1e-3, scale=1e-8, neutral=1e-6,
                        fit=fit(1e-8, 4e-8, low=1e-9))  # fmt: skip
    time_constant = parameter("s", 1e-3, 100.0, scale=0.05, neutral=0.05, fit=fit(3e-3, 0.02, 0.1, high=3.0))
    pressure = hidden("Pa", scale=1e5, integrated=True)

    @property
    def capacity(self) -> Symbol:
        """V / beta [m3/Pa]."""
        return self.time_constant * self.orifice / (2.0 * np.sqrt(RETURN_REFERENCE_PRESSURE))

    def tank(self, pressure: Symbol) -> Symbol:
        return pressure + self.pressure

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        passed = self.orifice * self.pressure / np.sqrt(np.abs(self.pressure) + LAMINAR_DROP)
        return {"pressure": (self.at.returned - passed) / self.capacity}


class SupplyPump(Effect):
    """Pump of limited flow Q on a volume V: V / beta p_s' = Q - c p_s - q_s, up to the pressure of its relief valve.

    c: leakage of the pump (Merritt 1967, section 4-2).
    """

    id = "supply_pump"
    equations = ("actuation",)
    sentence_template = (
        "The pump gives {flow_limit:.3g} ml/s at most, less {leakage:.3g} ml/s per MPa, onto {volume:.3g} l of oil: "
        "beyond, the supply falls below its {relief_pressure:.4g} MPa."
    )
    display_factors = {"flow_limit": 1e6, "volume": 1e3, "relief_pressure": 1e-6}
    single = True
    flow_limit = parameter("m3/s", 0.0, 1.0, scale=1e-5, neutral=1e-4,
                           fit=fit(6e-6, 2e-5, low=5e-7))  # fmt: skip
    relief_pressure = parameter("Pa", 1e4, 2e8, scale=1e5, neutral=16e6, fit=fit(16e6, low=4e6, high=32e6))
    volume = parameter("m3", 1e-9, 10.0, scale=1e-4, neutral=1e-3, fit=fit(2e-4, 1e-3, low=1e-5, high=0.1))
    leakage = parameter("m3/s/Pa", 0.0, 1e-9, scale=1e-13, fit=fit(1e-13, high=1e-10))
    sagged = hidden("Pa", scale=1e5, integrated=True)

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        limit, *others = super().fitted_parameters(bench)
        return replace(limit, high=limit.neutral), *others

    @property
    def capacity(self) -> Symbol:
        """V / beta [m3/Pa]."""
        return self.volume / self.at.bench.bulk_modulus

    def supply(self, pressure: Symbol) -> Symbol:
        return self.relief_pressure - np.fmax(self.sagged, 0.0)

    def rates(self, drawn: Symbol) -> dict[str, Symbol]:
        relieved = np.fmax(-self.sagged, 0.0) / RELIEF_TIME
        given = self.flow_limit - self.leakage * (self.relief_pressure - self.sagged)
        return {"sagged": (drawn - given) / self.capacity + relieved}


class LeakageInternal(Effect):
    """Laminar leakage between the chambers."""

    id = "leakage_internal"
    equations = _CHAMBERS
    family = "leak"
    sentence_template = "Oil leaks past the piston between the chambers, {coefficient:.3g} ml/s per MPa."
    coefficient = parameter("m3/s/Pa", 0.0, 1e-9, scale=1e-13, fit=_LAMINAR)

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        across = self.coefficient * (pressure_a - pressure_b)
        return across, -across


class LeakageInternalOrifice(LeakageInternal):
    """Leakage between the chambers through a sharp edge."""

    options = {"form": ("orifice",)}
    sentence_template = (
        "Oil leaks between the chambers as through a sharp edge, {coefficient:.3g} ml/s at 5 MPa between them."
    )
    display_factors = {"coefficient": 1e6 * ORIFICE_REFERENCE_DROP}

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        across = orifice(self.coefficient * np.sqrt(ORIFICE_REFERENCE_DROP), pressure_a - pressure_b)
        return across, -across


class LeakageExternal(Effect):
    """Laminar leakage from a chamber to the tank."""

    id = "leakage_external"
    options = {"chamber": ("a", "b")}
    family = "leak"
    coefficient = parameter("m3/s/Pa", 0.0, 1e-9, scale=1e-13, fit=_LAMINAR)

    def __init__(self, **chosen: str) -> None:
        super().__init__(**chosen)
        self.equations = (f"pressure_{self.chamber}",)
        self.sentence_template = f"Chamber {self.chamber.upper()} leaks to the tank, {{coefficient:.3g}} ml/s per MPa."

    def leaks(self, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Symbol, Symbol]:
        tank = self.at.bench.tank_pressure
        if self.chamber == "a":
            return self.coefficient * (pressure_a - tank), 0.0
        return 0.0, self.coefficient * (pressure_b - tank)


class BulkModulus(Effect):
    """Ratio of the bulk modulus beta to the bench file's, at all pressures."""

    id = "bulk_modulus"
    equations = _CHAMBERS
    family = "oil"
    sentence_template = "The bulk modulus is {ratio:.4g} times what the bench file says, at every pressure."
    equivalent_parameter = "bulk_modulus"
    ratio = parameter(
        "-", 0.01, 100.0, scale=0.1, neutral=1.0, fit=fit(0.9, smallest_reported=0.004, low=0.2, high=5.0)
    )

    def modulus(self, modulus: Symbol, pressure: Symbol) -> Symbol:
        return modulus * self.ratio


class OilDrift(Effect):
    """Drift of the bulk modulus, beta (1 + r t), with t since reset or since a recording began."""

    id = "oil_drift"
    equations = _CHAMBERS
    sentence_template = (
        "The oil's bulk modulus changes while recording, by {rate:.3g} % per second: it warms or aerates."
    )
    rate = parameter("1/s", -1.0, 1.0, scale=0.01, fit=fit(-0.005, smallest_reported=3e-4, low=-0.2, high=0.2))
    time = hidden("s", scale=10.0)

    def modulus(self, modulus: Symbol, pressure: Symbol) -> Symbol:
        return modulus * clip(1.0 + self.rate * (self.time + 0.5 * self.at.step), DRIFT_MIN, DRIFT_MAX)

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["time"] = self.time + self.at.step


class EntrainedAir(Effect):
    """Modulus of volumes o of oil and g of polytropic air, compressed together: (o + g) / (o / beta + g / (n p))."""

    id = "entrained_air"
    equations = _CHAMBERS
    family = "oil"
    exponent = 1.4
    sentence_template = (
        "{volume_fraction:.3g} % of free air (at atmospheric pressure) softens the oil where its pressure is low."
    )
    display_factors = {"volume_fraction": 100.0}
    volume_fraction = parameter("-", 0.0, 0.5, scale=0.005, fit=fit(0.003, 0.02, smallest_reported=1e-4, high=0.3))

    def modulus(self, modulus: Symbol, pressure: Symbol) -> Symbol:
        gauge = np.fmax(pressure, 0.0)
        absolute = gauge + ATMOSPHERIC_PRESSURE
        air = self.volume_fraction * np.exp(np.log(ATMOSPHERIC_PRESSURE / absolute) / self.exponent)
        oil = (1.0 - self.volume_fraction) * np.exp(-gauge / modulus)
        return (oil + air) / (oil / modulus + air / (self.exponent * absolute))


class EntrainedAirIsothermal(EntrainedAir):
    """Isothermal compression of the air: n = 1."""

    options = {"form": ("isothermal",)}
    exponent = 1.0


EFFECTS = (
    SupplyDroop, SupplyPump, ReturnLine, ReturnLineOrifice, LeakageInternal, LeakageInternalOrifice, LeakageExternal,
    BulkModulus, OilDrift, EntrainedAir, EntrainedAirIsothermal,
)  # fmt: skip
