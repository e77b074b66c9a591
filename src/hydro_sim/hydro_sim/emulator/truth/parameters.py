# SPDX-License-Identifier: Apache-2.0
"""Parameters of the compiled truth plant: one flat record made from a `TruthConfig`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.emulator.truth import effects as kinds
from hydro_sim.emulator.truth.config import TruthConfig

SUBSTEPS = 40  # of 25 us: not the step of the simulated plant, and short enough for the end stops
SUBSTEP_TIME = SAMPLE_PERIOD / SUBSTEPS
ATMOSPHERIC_PRESSURE = 101325.0  # Pa
DELAY_SAMPLES = 64  # ring of past commands; the largest transport delay is 50 ms

STATIC_FRICTION, SMOOTH_FRICTION, LUGRE_FRICTION = 1.0, 2.0, 3.0  # friction forms
NEVER_REACHED = 1e30  # a position or a rate limit that is never reached
UNIT_RATIO = kinds.TrueRatio(ratio=1.0)


def compile_parameters(config: TruthConfig) -> npt.NDArray[np.void]:
    """Return the parameters of the compiled plant, SI units: one record, shape (1,); absent effects are neutral."""
    numbers = _hydraulics(config) | _valve(config) | _friction(config) | _load(config) | _sensors(config)
    kind = np.dtype([(name, np.float64, np.shape(value)) for name, value in numbers.items()])
    return np.array([tuple(numbers.values())], kind)


def _hydraulics(config: TruthConfig) -> dict[str, Any]:
    bench, effects, outside = config.bench, config.effects, config.outside
    area = bench.piston_area * (effects.piston_area or UNIT_RATIO).ratio
    dead = {one.chamber: one.ratio for one in effects.dead_volume}
    air = effects.entrained_air or kinds.EntrainedAir(volume_fraction=0.0)
    droop = effects.supply_droop or kinds.SupplyDroop(resistance=0.0)
    line = effects.return_line or kinds.ReturnLine()
    source = bench.supply_pressure * (effects.supply_pressure or UNIT_RATIO).ratio
    pump = effects.supply_pump or kinds.SupplyPump(flow_limit=0.0)
    ripple = outside.supply_ripple or kinds.SupplyRipple(amplitude=0.0)
    internal = effects.leakage_internal or kinds.LeakageInternal(coefficient=0.0)
    external = {one.chamber: one.coefficient for one in effects.leakage_external}
    return {
        "area_a": area, "area_b": area * bench.area_ratio * (effects.area_ratio or UNIT_RATIO).ratio,
        "stroke": bench.stroke,
        "dead_volume_a": bench.dead_volume_a * dead.get("a", 1.0),
        "dead_volume_b": bench.dead_volume_b * dead.get("b", 1.0),
        "wall_compliance": outside.wall_flexibility.compliance if outside.wall_flexibility else 0.0,
        "bulk_modulus": bench.bulk_modulus * (effects.bulk_modulus or UNIT_RATIO).ratio,
        "air_fraction": air.volume_fraction, "air_exponent": 1.0 if air.form == "isothermal" else 1.4,
        "bulk_modulus_at_start": bench.bulk_modulus * (effects.bulk_modulus or UNIT_RATIO).ratio,
        "oil_drift": effects.oil_drift.rate if effects.oil_drift else 0.0,
        "source_pressure": pump.relief_pressure or source,
        "pump_flow": pump.flow_limit if effects.supply_pump else NEVER_REACHED, "pump_volume": pump.volume,
        "pump_leakage": pump.leakage,
        "tank_pressure": effects.tank_pressure.pressure if effects.tank_pressure else bench.tank_pressure,
        "droop_resistance": droop.resistance, "droop_time": droop.time_constant,
        "line_resistance": line.resistance, "line_time": line.time_constant,
        "line_orifice": line.orifice if line.form == "orifice" else 0.0,
        "ripple_amplitude": ripple.amplitude, "ripple_frequency": ripple.frequency,
        "leak_internal": internal.coefficient if internal.form == "laminar" else 0.0,
        "leak_internal_orifice": internal.coefficient * math.sqrt(5e6) if internal.form == "orifice" else 0.0,
        "leak_external_a": external.get("a", 0.0), "leak_external_b": external.get("b", 0.0),
    }  # fmt: skip


def _valve(config: TruthConfig) -> dict[str, Any]:
    bench, effects, outside = config.bench, config.effects, config.outside
    short = effects.valve_underlap.half_width if effects.valve_underlap else 0.0
    gain = (effects.valve_gain or UNIT_RATIO).ratio
    warm = outside.valve_temperature or kinds.ValveTemperature(change=0.0)
    band = effects.valve_deadband or kinds.ValveDeadband(half_width=0.0)
    overlaps = band.half_width, band.half_width if band.half_width_negative is None else band.half_width_negative
    edges = {one.edge: one for one in effects.valve_edge}
    each = [edges.get(name, kinds.ValveEdge(edge=name)) for name in kinds.EDGES]
    leak = effects.valve_null_leakage or kinds.ValveNullLeakage(coefficient=0.0)
    lag = effects.valve_lag or kinds.ValveLag(order=0)  # an ideal spool
    drop = bench.valve_nominal_pressure_drop / 2.0
    return {
        "orifice": bench.valve_nominal_flow / (bench.valve_nominal_current * math.sqrt(drop)),
        "gain_positive": gain, "gain_negative": gain * (effects.valve_gain_asymmetry or UNIT_RATIO).ratio,
        "gain_drift": effects.valve_gain_drift.rate if effects.valve_gain_drift else 0.0,
        "warm_change": warm.change, "warm_time": warm.time_constant,
        "overlap_positive": overlaps[0] - short, "overlap_negative": overlaps[1] - short,
        "edge_overlap": tuple(one.overlap for one in each), "edge_ratio": tuple(one.ratio for one in each),
        "softness": band.softness if band.form == "soft" else 0.0,
        "null_leak": leak.coefficient, "null_width": leak.width, "null_hyperbolic": float(leak.form == "hyperbolic"),
        "valve_offset": effects.valve_offset.current if effects.valve_offset else 0.0,
        "delay": effects.transport_delay.time if effects.transport_delay else 0.0,
        "spool_order": float(lag.order), "spool_frequency": 2.0 * math.pi * lag.bandwidth, "spool_damping": lag.damping,
        "spool_rate_limit": NEVER_REACHED if lag.rate_limit is None else lag.rate_limit,
    }  # fmt: skip


def _friction(config: TruthConfig) -> dict[str, Any]:
    effects, outside = config.effects, config.outside
    viscous = effects.friction_viscous.coefficient if effects.friction_viscous else 0.0
    coulomb = effects.friction_coulomb or kinds.FrictionCoulomb(force=0.0)
    stribeck = effects.friction_stribeck or kinds.FrictionStribeck(breakaway_force=0.0)
    bristles = effects.friction_presliding or kinds.FrictionPresliding()
    form = "lugre" if effects.friction_presliding else coulomb.form
    rib = outside.friction_rib or kinds.FrictionRib(force=0.0)
    return {
        "viscous": config.bench.viscous_friction + viscous,
        "friction_form": {"static": STATIC_FRICTION, "smooth": SMOOTH_FRICTION, "lugre": LUGRE_FRICTION}[form],
        "coulomb_positive": coulomb.force if coulomb.force_positive is None else coulomb.force_positive,
        "coulomb_negative": coulomb.force if coulomb.force_negative is None else coulomb.force_negative,
        "breakaway": stribeck.breakaway_force, "stribeck_velocity": stribeck.velocity,
        "stribeck_exponent": stribeck.exponent,
        "bristle_stiffness": bristles.stiffness, "bristle_damping": bristles.damping,
        "rib_force": rib.force, "rib_pitch": rib.pitch,
        "seal_friction": outside.friction_pressure.coefficient if outside.friction_pressure else 0.0,
    }  # fmt: skip


def _load(config: TruthConfig) -> dict[str, Any]:
    bench, effects, outside = config.bench, config.effects, config.outside
    backlash = effects.backlash or kinds.Backlash(width=0.0)
    hysteresis = outside.spring_hysteresis or kinds.SpringHysteresis(force=0.0)
    hum, walk = outside.load_hum or kinds.SinusoidalLoad(amplitude=0.0), outside.load_walk or kinds.LoadWalk(force=0.0)
    cushions = {"low": (-NEVER_REACHED, 0.0), "high": (NEVER_REACHED, 0.0)}
    quadratic = False
    for cushion in effects.end_cushion:
        quadratic = cushion.form == "quadratic"
        stiffness = cushion.stiffness / 5e-3 if quadratic else cushion.stiffness
        cushions["high" if cushion.position > 0.5 * bench.stroke else "low"] = cushion.position, stiffness
    return {
        "mass": bench.moving_mass + (effects.moving_mass.mass if effects.moving_mass else 0.0),
        "stiffness": bench.spring_stiffness * (effects.spring_stiffness or UNIT_RATIO).ratio,
        "hardening": effects.spring_hardening.coefficient if effects.spring_hardening else 0.0,
        "rest": effects.spring_rest.position if effects.spring_rest else bench.spring_rest_position,
        "backlash": backlash.width, "backlash_play": float(backlash.form == "play"),
        "hysteresis_force": hysteresis.force, "hysteresis_deflection": hysteresis.deflection,
        "hysteresis_exponent": hysteresis.exponent,
        "cushion_low": cushions["low"][0], "cushion_low_stiffness": cushions["low"][1],
        "cushion_high": cushions["high"][0], "cushion_high_stiffness": cushions["high"][1],
        "cushion_quadratic": float(quadratic),
        "force_offset": effects.force_offset.force if effects.force_offset else 0.0,
        "hum_amplitude": hum.amplitude, "hum_frequency": hum.frequency,
        "walk_force": walk.force, "walk_time": walk.correlation_time,
    }  # fmt: skip


def _sensors(config: TruthConfig) -> dict[str, Any]:
    bench, effects, sensors = config.bench, config.effects, config.sensors
    talk = config.outside.cell_crosstalk
    lags: dict[str, kinds.SensorLag] = {one.sensor: one for one in effects.sensor_lag}
    if bench.load_cell_bandwidth is not None:
        amplifier = kinds.SensorLag(bandwidth=bench.load_cell_bandwidth, damping=bench.load_cell_damping)
        lags.setdefault("load_force", amplifier)
    each = [lags.get(name, kinds.SensorLag(bandwidth=0.0, order=0)) for name in kinds.SENSORS]  # order 0: ideal
    gains: dict[str, float] = {gain.cell: gain.ratio for gain in effects.load_cell_gain}
    errors: dict[str, float] = {bias.cell: bias.force for bias in effects.load_cell_bias}
    errors |= {f"pressure_{error.chamber}": error.pressure for error in effects.pressure_sensor_bias}
    return {
        **{f"crosstalk_{cell}_{chamber}": 0.0 for cell in kinds.SENSORS[:2] for chamber in "ab"},
        **({f"crosstalk_{talk.cell}_{talk.chamber}": talk.coefficient} if talk else {}),
        "noise_force": sensors.noise_scale * sensors.force_noise,
        "noise_pressure": sensors.noise_scale * sensors.pressure_noise,
        "encoder_step": sensors.encoder_step,
        "lag_order": tuple(float(lag.order) for lag in each),
        "lag_frequency": tuple(2.0 * math.pi * lag.bandwidth for lag in each),
        "lag_damping": tuple(lag.damping for lag in each),
        "sensor_gain": tuple(gains.get(name, 1.0) for name in kinds.SENSORS),
        "sensor_bias": tuple(errors.get(name, 0.0) for name in kinds.SENSORS),
    }
