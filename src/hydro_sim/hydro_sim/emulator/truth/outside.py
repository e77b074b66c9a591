# SPDX-License-Identifier: Apache-2.0
"""Causes without a name in the diagnosis' table, for cases in which the right answer is "unknown"."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from hydro_bridge.settings import quantity


@dataclass(frozen=True, kw_only=True)
class FrictionRib:
    """Dry friction that varies along the bore: force (1 + sin(2 pi x / pitch)) / 2 against motion."""

    force: Annotated[float, quantity("N", 0.0, 500.0)]
    pitch: Annotated[float, quantity("m", 2e-4, 0.1)] = 4e-3


@dataclass(frozen=True, kw_only=True)
class FrictionPressure:
    """Dry friction of the seal that grows with the pressure across it: coefficient |p_a - p_b|."""

    coefficient: Annotated[float, quantity("N/Pa", 0.0, 1e-3)]


@dataclass(frozen=True, kw_only=True)
class SpringHysteresis:
    """Bouc-Wen element beside the spring: force w, w' = (v - (|v| |w|^(n-1) w + v |w|^n) / 2) / deflection."""

    force: Annotated[float, quantity("N", 0.0, 500.0)]
    deflection: Annotated[float, quantity("m", 1e-4, 0.05)] = 1e-3
    exponent: Annotated[float, quantity("-", 1.0, 4.0)] = 1.5


@dataclass(frozen=True, kw_only=True)
class ValveTemperature:
    """The valve's gain warms up: 1 + change (1 - exp(-t / time_constant))."""

    change: Annotated[float, quantity("-", -0.9, 5.0)]
    time_constant: Annotated[float, quantity("s", 0.1, 1e4)] = 10.0


@dataclass(frozen=True, kw_only=True)
class ValveUnderlap:
    """Lands shorter than the ports: near null both edges of a chamber are open."""

    half_width: Annotated[float, quantity("A", 0.0, 0.02)]


@dataclass(frozen=True, kw_only=True)
class CellCrosstalk:
    """A chamber's pressure strains a load cell."""

    coefficient: Annotated[float, quantity("N/Pa", -1e-3, 1e-3)]
    chamber: Literal["a", "b"] = "a"
    cell: Literal["hydraulic_force", "load_force"] = "load_force"


@dataclass(frozen=True, kw_only=True)
class LoadHum:
    """Sinusoidal force on the mass."""

    amplitude: Annotated[float, quantity("N", 0.0, 500.0)]
    frequency: Annotated[float, quantity("Hz", 0.01, 400.0)] = 50.0


@dataclass(frozen=True, kw_only=True)
class LoadWalk:
    """Random force on the mass: Ornstein-Uhlenbeck with this standard deviation and correlation time."""

    force: Annotated[float, quantity("N", 0.0, 500.0)]
    correlation_time: Annotated[float, quantity("s", 5e-3, 1e3)] = 1.0


@dataclass(frozen=True, kw_only=True)
class WallFlexibility:
    """Hoses that widen: both chambers grow by this volume per pressure."""

    compliance: Annotated[float, quantity("m3/Pa", 0.0, 1e-11)]


@dataclass(frozen=True, kw_only=True)
class SupplyRipple:
    """Ripple of the pump on the supply pressure."""

    amplitude: Annotated[float, quantity("Pa", 0.0, 5e6)]
    frequency: Annotated[float, quantity("Hz", 0.01, 400.0)] = 30.0


@dataclass(frozen=True, kw_only=True)
class Outside:
    """Causes without a name in the table; an absent one is off."""

    friction_rib: FrictionRib | None = None
    friction_pressure: FrictionPressure | None = None
    spring_hysteresis: SpringHysteresis | None = None
    valve_temperature: ValveTemperature | None = None
    valve_underlap: ValveUnderlap | None = None
    cell_crosstalk: CellCrosstalk | None = None
    load_hum: LoadHum | None = None
    load_walk: LoadWalk | None = None
    wall_flexibility: WallFlexibility | None = None
    supply_ripple: SupplyRipple | None = None
