# SPDX-License-Identifier: Apache-2.0
"""Effects of the truth plant beyond the nominal bench: names, magnitudes, units, ranges.

The class `Effects` holds the causes that have a name in the diagnosis' table, under the same ids and parameter names; a
`form` picks another functional form of the same cause. `UnnamedEffects` holds causes without a name there, for cases in
which the right answer is "unknown".
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from hydro_core.settings import quantity

SensorName = Literal["hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position"]
SENSORS: tuple[str, ...] = get_args(SensorName)
EdgeName = Literal["pa", "at", "pb", "bt"]
EDGES: tuple[EdgeName, ...] = get_args(EdgeName)


@dataclass(frozen=True, kw_only=True)
class FrictionCoulomb:
    """Constant force against motion. `static` sticks exactly, `smooth` rounds the sign, `lugre` has bristles."""

    force: Annotated[float, quantity("N", 0.0, 500.0)] = 12.0
    force_positive: Annotated[float, quantity("N", 0.0, 500.0)] | None = None  # while extending; absent: force
    force_negative: Annotated[float, quantity("N", 0.0, 500.0)] | None = None  # while retracting; absent: force
    form: Literal["static", "smooth", "lugre"] = "static"


@dataclass(frozen=True, kw_only=True)
class FrictionViscous:
    """Change of the viscous coefficient relative to the bench."""

    coefficient: Annotated[float, quantity("N s/m", -1000.0, 5000.0)]


@dataclass(frozen=True, kw_only=True)
class FrictionStribeck:
    """Extra force near standstill: breakaway_force exp(-|v / velocity|^exponent)."""

    breakaway_force: Annotated[float, quantity("N", 0.0, 500.0)]
    velocity: Annotated[float, quantity("m/s", 1e-4, 1.0)] = 0.01
    exponent: Annotated[float, quantity("-", 0.5, 4.0)] = 2.0  # 2 Gaussian, 1 exponential (Tustin)


@dataclass(frozen=True, kw_only=True)
class FrictionPresliding:
    """Elastic deflection before sliding, of a friction_coulomb of form lugre (which without it has these defaults)."""

    stiffness: Annotated[float, quantity("N/m", 1e4, 1.2e6)] = 5e5
    damping: Annotated[float, quantity("N s/m", 0.0, 5000.0)] = 300.0


@dataclass(frozen=True, kw_only=True)
class LeakageInternal:
    """Flow from chamber A to B. `orifice` follows the root of the pressure drop, equal to `laminar` at 5 MPa."""

    coefficient: Annotated[float, quantity("m3/s/Pa", 0.0, 1e-10)]
    form: Literal["laminar", "orifice"] = "laminar"


@dataclass(frozen=True, kw_only=True)
class LeakageExternal:
    """Flow from a chamber to the tank."""

    coefficient: Annotated[float, quantity("m3/s/Pa", 0.0, 1e-10)]
    chamber: Literal["a", "b"] = "a"


@dataclass(frozen=True, kw_only=True)
class ValveDeadband:
    """Overlap of the lands. `soft` rounds the corner over `softness`."""

    half_width: Annotated[float, quantity("A", 0.0, 0.02)]
    half_width_negative: Annotated[float, quantity("A", 0.0, 0.02)] | None = None  # lopsided; absent: half_width
    softness: Annotated[float, quantity("A", 1e-6, 0.01)] = 2e-4
    form: Literal["hard", "soft"] = "hard"


@dataclass(frozen=True, kw_only=True)
class ValveUnderlap:
    """Lands shorter than the ports: near null both edges of a chamber are open."""

    half_width: Annotated[float, quantity("A", 0.0, 0.02)]


@dataclass(frozen=True, kw_only=True)
class ValveEdge:
    """One edge (supply or tank to A or B) that opens later than the others, and passes a share of their flow."""

    edge: EdgeName
    overlap: Annotated[float, quantity("A", -0.02, 0.02)] = 0.0
    ratio: Annotated[float, quantity("-", 0.0, 10.0)] = 1.0


@dataclass(frozen=True, kw_only=True)
class ValveLag:
    """Spool dynamics. `bandwidth` is the natural frequency, or the corner frequency at first order."""

    bandwidth: Annotated[float, quantity("Hz", 5.0, 1000.0)] = 110.0
    damping: Annotated[float, quantity("-", 0.2, 5.0)] = 0.8
    rate_limit: Annotated[float, quantity("A/s", 0.05, 1000.0)] | None = None  # absent: none
    order: Annotated[int, quantity("-", 1, 2)] = 2


@dataclass(frozen=True, kw_only=True)
class TransportDelay:
    """Pure dead time on the command."""

    time: Annotated[float, quantity("s", 0.0, 0.05)]


@dataclass(frozen=True, kw_only=True)
class ValveOffset:
    """Null shift: added to the current before the spool."""

    current: Annotated[float, quantity("A", -0.02, 0.02)]


@dataclass(frozen=True, kw_only=True)
class TrueRatio:
    """True value over the bench file's value."""

    ratio: Annotated[float, quantity("-", 0.1, 10.0)]


@dataclass(frozen=True, kw_only=True)
class ValveNullLeakage:
    """Flow past all four worn edges, strongest at null: a profile that falls with the spool's distance from null."""

    coefficient: Annotated[float, quantity("m3/s/sqrt(Pa)", 0.0, 1e-7)]
    width: Annotated[float, quantity("A", 1e-5, 0.05)] = 2e-3
    form: Literal["bell", "hyperbolic"] = "bell"  # exp(-(s/width)^2); 1/(1 + |s|/width)


@dataclass(frozen=True, kw_only=True)
class SupplyDroop:
    """Accumulator behind a line: T p_s' = p_source - R q - p_s, with q what the valve draws."""

    resistance: Annotated[float, quantity("Pa s/m3", 0.0, 2e11)]
    time_constant: Annotated[float, quantity("s", 1e-3, 5.0)] = 0.02


@dataclass(frozen=True, kw_only=True)
class SupplyPump:
    """Pump of this flow on a volume of oil, with a relief valve: the supply sags while the valve draws more."""

    flow_limit: Annotated[float, quantity("m3/s", 0.0, 1.0)]
    relief_pressure: Annotated[float, quantity("Pa", 1e5, 1e8)] | None = None  # absent: the supply pressure
    volume: Annotated[float, quantity("m3", 1e-6, 1.0)] = 8e-4
    leakage: Annotated[float, quantity("m3/s/Pa", 0.0, 1e-9)] = 1e-13


@dataclass(frozen=True, kw_only=True)
class ReturnLine:
    """Volume behind a line to the tank: T p_r' = p_t + R q - p_r, with q what the valve returns.

    The form `orifice` has one in place of the resistance: p_r' = (q - orifice sqrt(p_r - p_t)) / C. There the time
    constant is that at 0.5 MPa.
    """

    resistance: Annotated[float, quantity("Pa s/m3", 0.0, 2e12)] = 0.0
    orifice: Annotated[float, quantity("m3/s/sqrt(Pa)", 1e-10, 1e-5)] = 1.5e-8
    time_constant: Annotated[float, quantity("s", 1e-3, 5.0)] = 0.02
    form: Literal["laminar", "orifice"] = "laminar"


@dataclass(frozen=True, kw_only=True)
class OilDrift:
    """Relative change of the bulk modulus over time, as oil warms."""

    rate: Annotated[float, quantity("1/s", -0.05, 0.05)]


@dataclass(frozen=True, kw_only=True)
class EntrainedAir:
    """Free air, as its share of the volume at atmospheric pressure; compressed adiabatically or isothermally."""

    volume_fraction: Annotated[float, quantity("-", 0.0, 0.1)]
    form: Literal["adiabatic", "isothermal"] = "adiabatic"


@dataclass(frozen=True, kw_only=True)
class LoadCellGain:
    """Gain error of one load cell."""

    ratio: Annotated[float, quantity("-", 0.2, 5.0)]
    cell: Literal["hydraulic_force", "load_force"] = "load_force"


@dataclass(frozen=True, kw_only=True)
class LoadCellBias:
    """Constant error of one load cell."""

    force: Annotated[float, quantity("N", -1000.0, 1000.0)]
    cell: Literal["hydraulic_force", "load_force"] = "load_force"


@dataclass(frozen=True, kw_only=True)
class PressureSensorBias:
    """Constant error of one pressure sensor."""

    pressure: Annotated[float, quantity("Pa", -5e6, 5e6)]
    chamber: Literal["a", "b"] = "a"


@dataclass(frozen=True, kw_only=True)
class SpringHardening:
    """Cubic term of the spring."""

    coefficient: Annotated[float, quantity("N/m3", -1e8, 1e10)]


@dataclass(frozen=True, kw_only=True)
class Backlash:
    """Lost motion at the load, total width. `gap`: no force about rest; `play`: the spring's end is dragged along."""

    width: Annotated[float, quantity("m", 0.0, 0.01)]
    form: Literal["gap", "play"] = "gap"


@dataclass(frozen=True, kw_only=True)
class MovingMass:
    """Change of the moving mass relative to the bench."""

    mass: Annotated[float, quantity("kg", -1.0, 20.0)]


@dataclass(frozen=True, kw_only=True)
class ValveGainDrift:
    """Relative change of the valve's gain over time."""

    rate: Annotated[float, quantity("1/s", -0.05, 0.05)]


@dataclass(frozen=True, kw_only=True)
class EndCushion:
    """Spring beyond `position`, towards the nearer end. `quadratic` has the force of `linear` at a depth of 5 mm."""

    position: Annotated[float, quantity("m", 0.0, 1.0)]
    stiffness: Annotated[float, quantity("N/m", 0.0, 1e6)]
    form: Literal["linear", "quadratic"] = "linear"


@dataclass(frozen=True, kw_only=True)
class ForceOffset:
    """Constant force on the mass, positive towards extension."""

    force: Annotated[float, quantity("N", -1000.0, 1000.0)]


@dataclass(frozen=True, kw_only=True)
class SensorLag:
    """Low-pass in a sensor's amplifier, by its natural frequency; on load_force it replaces the bench's own."""

    bandwidth: Annotated[float, quantity("Hz", 2.0, 2000.0)]
    sensor: SensorName = "load_force"
    order: Annotated[int, quantity("-", 1, 2)] = 2
    damping: Annotated[float, quantity("-", 0.3, 2.0)] = 0.7071067811865476


@dataclass(frozen=True, kw_only=True)
class DeadVolume:
    """True dead volume over the bench file's value, one chamber."""

    ratio: Annotated[float, quantity("-", 0.1, 10.0)]
    chamber: Literal["a", "b"] = "a"


@dataclass(frozen=True, kw_only=True)
class TankPressure:
    """True tank pressure."""

    pressure: Annotated[float, quantity("Pa", 0.0, 5e6)]


@dataclass(frozen=True, kw_only=True)
class SpringRest:
    """True rest position of the spring."""

    position: Annotated[float, quantity("m", 0.0, 1.0)]


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
    valve_underlap: ValveUnderlap | None = None
    valve_edge: tuple[ValveEdge, ...] = ()
    valve_lag: ValveLag | None = None
    transport_delay: TransportDelay | None = None
    valve_offset: ValveOffset | None = None
    valve_gain: TrueRatio | None = None
    valve_gain_asymmetry: TrueRatio | None = None
    valve_null_leakage: ValveNullLeakage | None = None
    valve_gain_drift: ValveGainDrift | None = None
    supply_droop: SupplyDroop | None = None
    supply_pump: SupplyPump | None = None
    return_line: ReturnLine | None = None
    bulk_modulus: TrueRatio | None = None
    oil_drift: OilDrift | None = None
    entrained_air: EntrainedAir | None = None
    load_cell_gain: tuple[LoadCellGain, ...] = ()
    load_cell_bias: tuple[LoadCellBias, ...] = ()
    pressure_sensor_bias: tuple[PressureSensorBias, ...] = ()
    sensor_lag: tuple[SensorLag, ...] = ()
    spring_stiffness: TrueRatio | None = None
    spring_hardening: SpringHardening | None = None
    spring_rest: SpringRest | None = None
    backlash: Backlash | None = None
    moving_mass: MovingMass | None = None
    end_cushion: tuple[EndCushion, ...] = ()
    force_offset: ForceOffset | None = None
    supply_pressure: TrueRatio | None = None
    tank_pressure: TankPressure | None = None
    piston_area: TrueRatio | None = None
    area_ratio: TrueRatio | None = None
    dead_volume: tuple[DeadVolume, ...] = ()


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
    """Bouc-Wen element parallel to the spring: force w, w' = (v - (|v| |w|^(n-1) w + v |w|^n) / 2) / deflection."""

    force: Annotated[float, quantity("N", 0.0, 500.0)]
    deflection: Annotated[float, quantity("m", 1e-4, 0.05)] = 1e-3
    exponent: Annotated[float, quantity("-", 1.0, 4.0)] = 1.5


@dataclass(frozen=True, kw_only=True)
class ValveTemperature:
    """Change of the valve's gain as it warms up: 1 + change (1 - exp(-t / time_constant))."""

    change: Annotated[float, quantity("-", -0.9, 5.0)]
    time_constant: Annotated[float, quantity("s", 0.1, 1e4)] = 10.0


@dataclass(frozen=True, kw_only=True)
class CellCrosstalk:
    """Crosstalk of a chamber's pressure into a load cell."""

    coefficient: Annotated[float, quantity("N/Pa", -1e-3, 1e-3)]
    chamber: Literal["a", "b"] = "a"
    cell: Literal["hydraulic_force", "load_force"] = "load_force"


@dataclass(frozen=True, kw_only=True)
class SinusoidalLoad:
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
class UnnamedEffects:
    """Causes without a name in the table; an absent one is off."""

    friction_rib: FrictionRib | None = None
    friction_pressure: FrictionPressure | None = None
    spring_hysteresis: SpringHysteresis | None = None
    valve_temperature: ValveTemperature | None = None
    cell_crosstalk: CellCrosstalk | None = None
    load_hum: SinusoidalLoad | None = None
    load_walk: LoadWalk | None = None
    wall_flexibility: WallFlexibility | None = None
    supply_ripple: SupplyRipple | None = None
