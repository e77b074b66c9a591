# SPDX-License-Identifier: Apache-2.0
"""One flat record of numbers for the compiled plant, made from a `TruthConfig`."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.emulator.truth.config import TruthBench, TruthConfig, TruthSensors
from hydro_sim.emulator.truth.effects import SENSORS, Effects, TrueRatio, UnnamedEffects

SUBSTEPS = 40  # of 25 us: not the step of the simulated plant, and short enough for the end stops
SUBSTEP = SAMPLE_PERIOD / SUBSTEPS
ATMOSPHERE = 101325.0  # Pa
DELAY_SAMPLES = 64  # ring of past commands; the largest transport delay is 50 ms

STATIC, SMOOTH, LUGRE = 1.0, 2.0, 3.0  # friction forms; 0 is none
OFF = 1e30  # a position or a rate limit that is never reached

# fmt: off
_SCALARS = (
    "area_a", "area_b", "stroke", "dead_volume_a", "dead_volume_b", "wall_compliance",
    "bulk_modulus", "air_fraction", "air_exponent",
    "source_pressure", "tank_pressure", "droop_resistance", "droop_time", "ripple_amplitude", "ripple_frequency",
    "orifice", "gain_positive", "gain_negative", "gain_drift", "warm_change", "warm_time",
    "overlap_positive", "overlap_negative", "softness", "null_leak", "null_width", "null_hyperbolic",
    "valve_offset", "delay", "spool_order", "spool_frequency", "spool_damping", "spool_rate_limit",
    "leak_internal", "leak_internal_orifice", "leak_external_a", "leak_external_b",
    "mass", "viscous", "friction_form", "coulomb_positive", "coulomb_negative", "breakaway", "stribeck_velocity",
    "stribeck_exponent",
    "bristle_stiffness", "bristle_damping", "rib_force", "rib_pitch", "seal_friction",
    "stiffness", "hardening", "rest", "backlash", "backlash_play", "hysteresis_force", "hysteresis_deflection",
    "hysteresis_exponent",
    "cushion_low", "cushion_low_stiffness", "cushion_high", "cushion_high_stiffness", "cushion_quadratic",
    "force_offset", "hum_amplitude", "hum_frequency", "walk_force", "walk_time",
    "crosstalk_hydraulic_force_a", "crosstalk_hydraulic_force_b", "crosstalk_load_force_a", "crosstalk_load_force_b",
    "noise_force", "noise_pressure", "encoder_step",
)
# fmt: on
_ARRAYS = ("lag_order", "lag_frequency", "lag_damping", "sensor_gain", "sensor_bias")  # one entry per SENSORS

PARAMETERS = np.dtype(
    [(name, np.float64) for name in _SCALARS] + [(name, np.float64, (len(SENSORS),)) for name in _ARRAYS]
)


def compile_parameters(config: TruthConfig) -> npt.NDArray[np.void]:
    """Numbers of the compiled plant, shape (1,) of `PARAMETERS`, SI units."""
    record = np.zeros(1, PARAMETERS)
    p = record[0]
    _hydraulics(p, config.bench, config.effects)
    _valve(p, config.bench, config.effects)
    _friction(p, config.bench, config.effects)
    _load(p, config.bench, config.effects)
    _sensors(p, config.bench, config.sensors, config.effects)
    _outside(p, config.outside)
    return record


def _ratio(effect: TrueRatio | None) -> float:
    return 1.0 if effect is None else effect.ratio


def _hydraulics(p: np.void, bench: TruthBench, effects: Effects) -> None:
    p["area_a"] = bench.piston_area * _ratio(effects.piston_area)
    p["area_b"] = p["area_a"] * bench.area_ratio * _ratio(effects.area_ratio)
    p["stroke"] = bench.stroke
    dead = {item.chamber: item.ratio for item in effects.dead_volume}
    p["dead_volume_a"] = bench.dead_volume_a * dead.get("a", 1.0)
    p["dead_volume_b"] = bench.dead_volume_b * dead.get("b", 1.0)
    p["bulk_modulus"] = bench.bulk_modulus * _ratio(effects.bulk_modulus)
    air = effects.entrained_air
    p["air_fraction"] = 0.0 if air is None else air.volume_fraction
    p["air_exponent"] = 1.0 if air is None or air.form == "isothermal" else 1.4
    p["source_pressure"] = bench.supply_pressure * _ratio(effects.supply_pressure)
    p["tank_pressure"] = bench.tank_pressure if effects.tank_pressure is None else effects.tank_pressure.pressure
    droop = effects.supply_droop
    p["droop_resistance"] = 0.0 if droop is None else droop.resistance
    p["droop_time"] = 1.0 if droop is None else droop.time_constant
    internal = effects.leakage_internal
    if internal is not None and internal.form == "laminar":
        p["leak_internal"] = internal.coefficient
    elif internal is not None:
        p["leak_internal_orifice"] = internal.coefficient * math.sqrt(5e6)
    external = {item.chamber: item.coefficient for item in effects.leakage_external}
    p["leak_external_a"], p["leak_external_b"] = external.get("a", 0.0), external.get("b", 0.0)


def _valve(p: np.void, bench: TruthBench, effects: Effects) -> None:
    p["orifice"] = bench.valve_nominal_flow / (
        bench.valve_nominal_current * math.sqrt(bench.valve_nominal_pressure_drop / 2.0)
    )
    p["gain_positive"] = _ratio(effects.valve_gain)
    p["gain_negative"] = p["gain_positive"] * _ratio(effects.valve_gain_asymmetry)
    p["gain_drift"] = 0.0 if effects.valve_gain_drift is None else effects.valve_gain_drift.rate
    p["valve_offset"] = 0.0 if effects.valve_offset is None else effects.valve_offset.current
    p["delay"] = 0.0 if effects.transport_delay is None else effects.transport_delay.time
    band = effects.valve_deadband
    if band is not None:
        p["overlap_positive"] = band.half_width
        p["overlap_negative"] = band.half_width if band.half_width_negative is None else band.half_width_negative
        p["softness"] = band.softness if band.form == "soft" else 0.0
    leak = effects.valve_null_leakage
    p["null_leak"] = 0.0 if leak is None else leak.coefficient
    p["null_width"] = 1.0 if leak is None else leak.width
    p["null_hyperbolic"] = float(leak is not None and leak.form == "hyperbolic")
    lag = effects.valve_lag
    p["spool_rate_limit"] = OFF
    if lag is not None:
        p["spool_order"] = float(lag.order)
        p["spool_frequency"] = 2.0 * math.pi * lag.bandwidth
        p["spool_damping"] = lag.damping
        p["spool_rate_limit"] = OFF if lag.rate_limit is None else lag.rate_limit


def _friction(p: np.void, bench: TruthBench, effects: Effects) -> None:
    viscous = effects.friction_viscous
    p["viscous"] = bench.viscous_friction + (0.0 if viscous is None else viscous.coefficient)
    coulomb, stribeck, bristles = effects.friction_coulomb, effects.friction_stribeck, effects.friction_presliding
    if coulomb is not None:
        p["coulomb_positive"] = coulomb.force if coulomb.force_positive is None else coulomb.force_positive
        p["coulomb_negative"] = coulomb.force if coulomb.force_negative is None else coulomb.force_negative
    p["stribeck_velocity"], p["stribeck_exponent"] = 1.0, 2.0
    if stribeck is not None:
        p["breakaway"] = stribeck.breakaway_force
        p["stribeck_velocity"], p["stribeck_exponent"] = stribeck.velocity, stribeck.exponent
    p["friction_form"] = STATIC
    if coulomb is not None:
        p["friction_form"] = {"static": STATIC, "smooth": SMOOTH, "lugre": LUGRE}[coulomb.form]
    p["bristle_stiffness"], p["bristle_damping"] = 5e5, 300.0
    if bristles is not None:
        p["friction_form"] = LUGRE
        p["bristle_stiffness"], p["bristle_damping"] = bristles.stiffness, bristles.damping


def _load(p: np.void, bench: TruthBench, effects: Effects) -> None:
    p["mass"] = bench.moving_mass + (0.0 if effects.moving_mass is None else effects.moving_mass.mass)
    p["stiffness"] = bench.spring_stiffness * _ratio(effects.spring_stiffness)
    p["hardening"] = 0.0 if effects.spring_hardening is None else effects.spring_hardening.coefficient
    p["rest"] = bench.spring_rest_position if effects.spring_rest is None else effects.spring_rest.position
    p["backlash"] = 0.0 if effects.backlash is None else effects.backlash.width
    p["backlash_play"] = float(effects.backlash is not None and effects.backlash.form == "play")
    p["force_offset"] = 0.0 if effects.force_offset is None else effects.force_offset.force
    p["cushion_low"], p["cushion_high"] = -OFF, OFF
    for cushion in effects.end_cushion:
        end = "cushion_high" if cushion.position > 0.5 * bench.stroke else "cushion_low"
        quadratic = cushion.form == "quadratic"
        p[end] = cushion.position
        p[end + "_stiffness"] = cushion.stiffness / 5e-3 if quadratic else cushion.stiffness
        p["cushion_quadratic"] = float(quadratic)


def _sensors(p: np.void, bench: TruthBench, sensors: TruthSensors, effects: Effects) -> None:
    p["noise_force"] = sensors.noise_scale * sensors.force_noise
    p["noise_pressure"] = sensors.noise_scale * sensors.pressure_noise
    p["encoder_step"] = sensors.encoder_step
    p["sensor_gain"] = 1.0
    for gain in effects.load_cell_gain:
        p["sensor_gain"][SENSORS.index(gain.cell)] = gain.ratio
    for bias in effects.load_cell_bias:
        p["sensor_bias"][SENSORS.index(bias.cell)] = bias.force
    for error in effects.pressure_sensor_bias:
        p["sensor_bias"][SENSORS.index("pressure_" + error.chamber)] = error.pressure
    if bench.load_cell_bandwidth is not None:
        _lag(p, "load_force", 2, bench.load_cell_bandwidth, bench.load_cell_damping)
    for lag in effects.sensor_lag:
        _lag(p, lag.sensor, lag.order, lag.bandwidth, lag.damping)


def _lag(p: np.void, sensor: str, order: int, bandwidth: float, damping: float) -> None:
    index = SENSORS.index(sensor)
    p["lag_order"][index] = order
    p["lag_frequency"][index] = 2.0 * math.pi * bandwidth
    p["lag_damping"][index] = damping


def _outside(p: np.void, outside: UnnamedEffects) -> None:
    p["rib_pitch"] = p["hysteresis_deflection"] = p["hysteresis_exponent"] = p["warm_time"] = p["walk_time"] = 1.0
    if outside.friction_rib is not None:
        p["rib_force"], p["rib_pitch"] = outside.friction_rib.force, outside.friction_rib.pitch
    if outside.friction_pressure is not None:
        p["seal_friction"] = outside.friction_pressure.coefficient
    if outside.spring_hysteresis is not None:
        p["hysteresis_force"] = outside.spring_hysteresis.force
        p["hysteresis_deflection"] = outside.spring_hysteresis.deflection
        p["hysteresis_exponent"] = outside.spring_hysteresis.exponent
    if outside.valve_temperature is not None:
        p["warm_change"], p["warm_time"] = outside.valve_temperature.change, outside.valve_temperature.time_constant
    if outside.valve_underlap is not None:
        p["overlap_positive"] = p["overlap_negative"] = -outside.valve_underlap.half_width
    if outside.cell_crosstalk is not None:
        talk = outside.cell_crosstalk
        p[f"crosstalk_{talk.cell}_{talk.chamber}"] = talk.coefficient
    if outside.load_hum is not None:
        p["hum_amplitude"], p["hum_frequency"] = outside.load_hum.amplitude, outside.load_hum.frequency
    if outside.load_walk is not None:
        p["walk_force"], p["walk_time"] = outside.load_walk.force, outside.load_walk.correlation_time
    if outside.wall_flexibility is not None:
        p["wall_compliance"] = outside.wall_flexibility.compliance
    if outside.supply_ripple is not None:
        p["ripple_amplitude"], p["ripple_frequency"] = outside.supply_ripple.amplitude, outside.supply_ripple.frequency
