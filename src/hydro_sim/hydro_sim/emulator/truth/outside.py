# SPDX-License-Identifier: Apache-2.0
"""Causes without a name in the diagnosis' table, for cases in which the right answer is "unknown"."""

from __future__ import annotations

from dataclasses import dataclass

from hydro_sim.yaml_settings import choice, quantity


@dataclass(frozen=True, kw_only=True)
class FrictionRib:
    """Dry friction that varies along the bore: force (1 + sin(2 pi x / pitch)) / 2 against motion."""

    force: float = quantity(unit="N", low=0.0, high=500.0)
    pitch: float = quantity(4e-3, unit="m", low=2e-4, high=0.1)


@dataclass(frozen=True, kw_only=True)
class FrictionPressure:
    """Dry friction of the seal that grows with the pressure across it: coefficient |p_a - p_b|."""

    coefficient: float = quantity(unit="N/Pa", low=0.0, high=1e-3)


@dataclass(frozen=True, kw_only=True)
class SpringHysteresis:
    """Bouc-Wen element beside the spring: force w, w' = (v - (|v| |w|^(n-1) w + v |w|^n) / 2) / deflection."""

    force: float = quantity(unit="N", low=0.0, high=500.0)
    deflection: float = quantity(1e-3, unit="m", low=1e-4, high=0.05)
    exponent: float = quantity(1.5, low=1.0, high=4.0)


@dataclass(frozen=True, kw_only=True)
class ValveTemperature:
    """The valve's gain warms up: 1 + change (1 - exp(-t / time_constant))."""

    change: float = quantity(low=-0.9, high=5.0)
    time_constant: float = quantity(10.0, unit="s", low=0.1, high=1e4)


@dataclass(frozen=True, kw_only=True)
class ValveUnderlap:
    """Lands shorter than the ports: near null both edges of a chamber are open."""

    half_width: float = quantity(unit="A", low=0.0, high=0.02)


@dataclass(frozen=True, kw_only=True)
class CellCrosstalk:
    """A chamber's pressure strains a load cell."""

    coefficient: float = quantity(unit="N/Pa", low=-1e-3, high=1e-3)
    chamber: str = choice("a", "a", "b")
    cell: str = choice("load_force", "hydraulic_force", "load_force")


@dataclass(frozen=True, kw_only=True)
class LoadHum:
    """Sinusoidal force on the mass."""

    amplitude: float = quantity(unit="N", low=0.0, high=500.0)
    frequency: float = quantity(50.0, unit="Hz", low=0.01, high=400.0)


@dataclass(frozen=True, kw_only=True)
class LoadWalk:
    """Random force on the mass: Ornstein-Uhlenbeck with this standard deviation and correlation time."""

    force: float = quantity(unit="N", low=0.0, high=500.0)
    correlation_time: float = quantity(1.0, unit="s", low=5e-3, high=1e3)


@dataclass(frozen=True, kw_only=True)
class WallFlexibility:
    """Hoses that widen: both chambers grow by this volume per pressure."""

    compliance: float = quantity(unit="m3/Pa", low=0.0, high=1e-11)


@dataclass(frozen=True, kw_only=True)
class SupplyRipple:
    """Ripple of the pump on the supply pressure."""

    amplitude: float = quantity(unit="Pa", low=0.0, high=5e6)
    frequency: float = quantity(30.0, unit="Hz", low=0.01, high=400.0)


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
