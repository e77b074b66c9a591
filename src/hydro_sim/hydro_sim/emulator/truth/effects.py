# SPDX-License-Identifier: Apache-2.0
"""What the truth plant can have that the nominal bench lacks: names, magnitudes, units, ranges.

The class `Effects` holds the causes that have a name in the diagnosis' table, under the same ids and parameter names; a
`form` picks another functional form of the same cause. `outside.py` holds causes that have no name there.
"""

from __future__ import annotations

from dataclasses import dataclass

from hydro_sim.yaml_settings import choice, quantity

SENSORS = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")


@dataclass(frozen=True, kw_only=True)
class FrictionCoulomb:
    """Constant force against motion. `static` sticks exactly, `smooth` rounds the sign, `lugre` has bristles."""

    force: float = quantity(12.0, unit="N", low=0.0, high=500.0)
    force_positive: float | None = quantity(None, unit="N", low=0.0, high=500.0)  # while extending; absent: force
    force_negative: float | None = quantity(None, unit="N", low=0.0, high=500.0)  # while retracting; absent: force
    form: str = choice("static", "static", "smooth", "lugre")


@dataclass(frozen=True, kw_only=True)
class FrictionViscous:
    """Change of the viscous coefficient against the bench."""

    coefficient: float = quantity(unit="N s/m", low=-1000.0, high=5000.0)


@dataclass(frozen=True, kw_only=True)
class FrictionStribeck:
    """Extra force near standstill: breakaway_force exp(-|v / velocity|^exponent)."""

    breakaway_force: float = quantity(unit="N", low=0.0, high=500.0)
    velocity: float = quantity(0.01, unit="m/s", low=1e-4, high=1.0)
    exponent: float = quantity(2.0, low=0.5, high=4.0)  # 2 Gaussian, 1 exponential (Tustin)


@dataclass(frozen=True, kw_only=True)
class FrictionPresliding:
    """Elastic deflection before sliding, of a friction_coulomb of form lugre (which without it has these defaults)."""

    stiffness: float = quantity(5e5, unit="N/m", low=1e4, high=1.2e6)
    damping: float = quantity(300.0, unit="N s/m", low=0.0, high=5000.0)


@dataclass(frozen=True, kw_only=True)
class LeakageInternal:
    """Flow from chamber A to chamber B. `orifice` goes with the root and meets `laminar` at 5 MPa."""

    coefficient: float = quantity(unit="m3/s/Pa", low=0.0, high=1e-10)
    form: str = choice("laminar", "laminar", "orifice")


@dataclass(frozen=True, kw_only=True)
class LeakageExternal:
    """Flow from a chamber to the tank."""

    coefficient: float = quantity(unit="m3/s/Pa", low=0.0, high=1e-10)
    chamber: str = choice("a", "a", "b")


@dataclass(frozen=True, kw_only=True)
class ValveDeadband:
    """Overlap of the lands. `soft` rounds the corner over `softness`."""

    half_width: float = quantity(unit="A", low=0.0, high=0.02)
    half_width_negative: float | None = quantity(None, unit="A", low=0.0, high=0.02)  # lopsided; absent: half_width
    softness: float = quantity(2e-4, unit="A", low=1e-6, high=0.01)
    form: str = choice("hard", "hard", "soft")


@dataclass(frozen=True, kw_only=True)
class ValveLag:
    """Spool dynamics. `bandwidth` is the natural frequency, or the corner frequency at first order."""

    bandwidth: float = quantity(110.0, unit="Hz", low=5.0, high=1000.0)
    damping: float = quantity(0.8, low=0.2, high=5.0)
    rate_limit: float | None = quantity(None, unit="A/s", low=0.05, high=1000.0)  # absent: none
    order: int = quantity(2, low=1, high=2)


@dataclass(frozen=True, kw_only=True)
class TransportDelay:
    """Pure dead time on the command."""

    time: float = quantity(unit="s", low=0.0, high=0.05)


@dataclass(frozen=True, kw_only=True)
class ValveOffset:
    """Null shift: added to the current before the spool."""

    current: float = quantity(unit="A", low=-0.02, high=0.02)


@dataclass(frozen=True, kw_only=True)
class Ratio:
    """True value over the bench file's value."""

    ratio: float = quantity(low=0.1, high=10.0)


@dataclass(frozen=True, kw_only=True)
class ValveNullLeakage:
    """Flow past all four worn edges, strongest at null: a profile that falls with the spool's distance from null."""

    coefficient: float = quantity(unit="m3/s/sqrt(Pa)", low=0.0, high=1e-7)
    width: float = quantity(2e-3, unit="A", low=1e-5, high=0.05)
    form: str = choice("bell", "bell", "hyperbolic")  # exp(-(s/width)^2); 1/(1 + |s|/width)


@dataclass(frozen=True, kw_only=True)
class SupplyDroop:
    """Accumulator behind a line: T p_s' = p_source - R q - p_s, with q what the valve draws."""

    resistance: float = quantity(unit="Pa s/m3", low=0.0, high=2e11)
    time_constant: float = quantity(0.02, unit="s", low=1e-3, high=5.0)


@dataclass(frozen=True, kw_only=True)
class EntrainedAir:
    """Free air, as its share of the volume at atmospheric pressure; compressed adiabatically or isothermally."""

    volume_fraction: float = quantity(low=0.0, high=0.1)
    form: str = choice("adiabatic", "adiabatic", "isothermal")


@dataclass(frozen=True, kw_only=True)
class LoadCellGain:
    """Gain error of one load cell."""

    ratio: float = quantity(low=0.2, high=5.0)
    cell: str = choice("load_force", "hydraulic_force", "load_force")


@dataclass(frozen=True, kw_only=True)
class LoadCellBias:
    """Constant error of one load cell."""

    force: float = quantity(unit="N", low=-1000.0, high=1000.0)
    cell: str = choice("load_force", "hydraulic_force", "load_force")


@dataclass(frozen=True, kw_only=True)
class PressureSensorBias:
    """Constant error of one pressure sensor."""

    pressure: float = quantity(unit="Pa", low=-5e6, high=5e6)
    chamber: str = choice("a", "a", "b")


@dataclass(frozen=True, kw_only=True)
class SpringHardening:
    """Cubic term of the spring."""

    coefficient: float = quantity(unit="N/m3", low=-1e8, high=1e10)


@dataclass(frozen=True, kw_only=True)
class Backlash:
    """Lost motion at the load, total width. `gap`: no force about rest; `play`: the spring's end is dragged along."""

    width: float = quantity(unit="m", low=0.0, high=0.01)
    form: str = choice("gap", "gap", "play")


@dataclass(frozen=True, kw_only=True)
class MovingMass:
    """Change of the moving mass against the bench."""

    mass: float = quantity(unit="kg", low=-1.0, high=20.0)


@dataclass(frozen=True, kw_only=True)
class ValveGainDrift:
    """Relative change of the valve's gain over time."""

    rate: float = quantity(unit="1/s", low=-0.05, high=0.05)


@dataclass(frozen=True, kw_only=True)
class EndCushion:
    """Spring that meets the piston beyond `position`, towards the nearer end. `quadratic` meets `linear` 5 mm in."""

    position: float = quantity(unit="m", low=0.0, high=1.0)
    stiffness: float = quantity(unit="N/m", low=0.0, high=1e6)
    form: str = choice("linear", "linear", "quadratic")


@dataclass(frozen=True, kw_only=True)
class ForceOffset:
    """Constant force on the mass, positive towards extension."""

    force: float = quantity(unit="N", low=-1000.0, high=1000.0)


@dataclass(frozen=True, kw_only=True)
class SensorLag:
    """Low-pass in a sensor's amplifier, by its natural frequency; on load_force it takes the place of the bench's."""

    bandwidth: float = quantity(unit="Hz", low=2.0, high=2000.0)
    sensor: str = choice("load_force", *SENSORS)
    order: int = quantity(2, low=1, high=2)
    damping: float = quantity(0.7071067811865476, low=0.3, high=2.0)


@dataclass(frozen=True, kw_only=True)
class DeadVolume:
    """True dead volume over the bench file's value, one chamber."""

    ratio: float = quantity(low=0.1, high=10.0)
    chamber: str = choice("a", "a", "b")


@dataclass(frozen=True, kw_only=True)
class TankPressure:
    """True tank pressure."""

    pressure: float = quantity(unit="Pa", low=0.0, high=5e6)


@dataclass(frozen=True, kw_only=True)
class SpringRest:
    """True rest position of the spring."""

    position: float = quantity(unit="m", low=0.0, high=1.0)


@dataclass(frozen=True, kw_only=True)
class Effects:
    """Causes with a name in the diagnosis' table; an absent one is off. Tuples take one mapping or a list."""

    friction_coulomb: FrictionCoulomb | None = None
    friction_viscous: FrictionViscous | None = None
    friction_stribeck: FrictionStribeck | None = None
    friction_presliding: FrictionPresliding | None = None
    leakage_internal: LeakageInternal | None = None
    leakage_external: tuple[LeakageExternal, ...] = ()
    valve_deadband: ValveDeadband | None = None
    valve_lag: ValveLag | None = None
    transport_delay: TransportDelay | None = None
    valve_offset: ValveOffset | None = None
    valve_gain: Ratio | None = None
    valve_gain_asymmetry: Ratio | None = None
    valve_null_leakage: ValveNullLeakage | None = None
    valve_gain_drift: ValveGainDrift | None = None
    supply_droop: SupplyDroop | None = None
    bulk_modulus: Ratio | None = None
    entrained_air: EntrainedAir | None = None
    load_cell_gain: tuple[LoadCellGain, ...] = ()
    load_cell_bias: tuple[LoadCellBias, ...] = ()
    pressure_sensor_bias: tuple[PressureSensorBias, ...] = ()
    sensor_lag: tuple[SensorLag, ...] = ()
    spring_stiffness: Ratio | None = None
    spring_hardening: SpringHardening | None = None
    spring_rest: SpringRest | None = None
    backlash: Backlash | None = None
    moving_mass: MovingMass | None = None
    end_cushion: tuple[EndCushion, ...] = ()
    force_offset: ForceOffset | None = None
    supply_pressure: Ratio | None = None
    tank_pressure: TankPressure | None = None
    piston_area: Ratio | None = None
    area_ratio: Ratio | None = None
    dead_volume: tuple[DeadVolume, ...] = ()
