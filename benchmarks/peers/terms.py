# SPDX-License-Identifier: Apache-2.0
"""Candidate terms for sparse regression, by equation: every cause of the diagnosis' table is among them.

What is not linear in its parameter (a dead band's width, a lag's corner) stands on a grid of values. A term's name is
`id` or `id@value`; causes that have the same term in an equation share it as `id|id`.
"""

from __future__ import annotations

import numpy as np

from benchmarks.peers.run import DROOPS, LAGS, Signals
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING

Terms = dict[str, FloatArray]


def roots(signal: Signals, bench: Bench) -> dict[str, FloatArray]:
    """Odd roots of the pressure drops across the four edges [sqrt(Pa)]."""
    drops = {
        "supply_a": bench.supply_pressure - signal["pressure_a"],
        "a_tank": signal["pressure_a"] - bench.tank_pressure,
        "supply_b": bench.supply_pressure - signal["pressure_b"],
        "b_tank": signal["pressure_b"] - bench.tank_pressure,
    }
    return {edge: np.sign(drop) * np.sqrt(np.abs(drop)) for edge, drop in drops.items()}


def flows(signal: Signals, bench: Bench, current: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flow into A and out of B [m3/s] at a current [A]."""
    root, gain = roots(signal, bench), bench.valve_gain
    out, back = np.maximum(current, 0.0), np.minimum(current, 0.0)
    return (gain * (out * root["supply_a"] + back * root["a_tank"]),
            gain * (out * root["b_tank"] + back * root["supply_b"]))  # fmt: skip


def stiffness(signal: Signals, bench: Bench) -> tuple[FloatArray, FloatArray]:
    """beta / V of both chambers [Pa/m3]."""
    volume_a = bench.dead_volume_a + bench.piston_area * signal["position"]
    rest = bench.area_ratio * bench.piston_area * (bench.stroke - signal["position"])
    return bench.bulk_modulus / volume_a, bench.bulk_modulus / (bench.dead_volume_b + rest)


def nominal(signal: Signals, bench: Bench) -> dict[str, FloatArray]:
    """Rates of the nominal bench along a recording, by equation of `DYNAMIC`.

    The force is the load cell's, so that its noise is not that of the terms, which are made of the pressures: a
    regression would explain the one by the other.
    """
    flow_a, flow_b = flows(signal, bench, signal["current"])
    stiff_a, stiff_b = stiffness(signal, bench)
    swept = bench.piston_area * signal["velocity"]
    spring = bench.spring_stiffness * (signal["position"] - bench.spring_rest_position)
    return {
        "velocity": (signal["hydraulic_force"] - bench.viscous_friction * signal["velocity"] - spring)
        / bench.moving_mass,
        "pressure_a": stiff_a * (flow_a - swept),
        "pressure_b": stiff_b * (bench.area_ratio * swept - flow_b),
    }


def readings(model: SegmentModel, bench: Bench) -> dict[str, FloatArray]:
    """What the nominal bench's load cells would show along a recording, by equation of `READ`."""
    spring = bench.spring_stiffness * (model.channels["piston_position"] - bench.spring_rest_position)
    if bench.load_cell_bandwidth is not None:
        spring = model.memory.low_pass("peer", spring, bench.load_cell_bandwidth, LOAD_CELL_DAMPING)
    pressures = model.channels["pressure_a"] - bench.area_ratio * model.channels["pressure_b"]
    return {"load_force": spring, "hydraulic_force": bench.piston_area * pressures}


def pressure_terms(signal: Signals, bench: Bench, chamber: str) -> Terms:
    """Terms of p_a' or p_b' [Pa/s]."""
    k = "ab".index(chamber)
    sign, stiff = (1.0, -1.0)[k], stiffness(signal, bench)[k]
    own, other = signal[f"pressure_{chamber}"], signal["pressure_" + "ba"[k]]
    current, root = signal["current"], roots(signal, bench)

    def through(u: FloatArray) -> FloatArray:
        """Rate by the flow at a current."""
        return sign * stiff * flows(signal, bench, u)[k]

    area = bench.piston_area * (1.0, bench.area_ratio)[k]
    rate = through(current) - sign * stiff * area * signal["velocity"]
    fed = np.maximum(current, 0.0) if k == 0 else np.minimum(current, 0.0)  # fed from the supply
    drained = np.minimum(current, 0.0) if k == 0 else np.maximum(current, 0.0)
    from_supply = sign * stiff * bench.valve_gain * fed * 0.5 / np.maximum(np.abs(root[f"supply_{chamber}"]), 100.0)
    to_tank = -sign * stiff * bench.valve_gain * drained * 0.5 / np.maximum(np.abs(root[f"{chamber}_tank"]), 100.0)
    terms = {
        "valve_gain": through(current),
        "valve_gain_asymmetry": through(np.minimum(current, 0.0)),
        "valve_offset": through(np.sign(current) * 1.0) * np.sign(current),
        "valve_gain_drift": through(current) * signal["time"],
        "leakage_internal": stiff * (other - own),
        "leakage_internal@orifice": stiff * np.sign(other - own) * np.sqrt(np.abs(other - own)),
        "leakage_external": stiff * (own - bench.tank_pressure),
        "bulk_modulus": rate,
        "dead_volume": rate * stiff / bench.bulk_modulus,
        "piston_area|area_ratio": stiff * signal["velocity"],
        "entrained_air": rate * (1e5 / (np.maximum(own, 0.0) + 1e5)) ** 1.714,
        "entrained_air@isothermal": rate * (1e5 / (np.maximum(own, 0.0) + 1e5)) ** 2,
        "supply_pressure": from_supply,
        "tank_pressure": to_tank,
        "transport_delay": through(signal["later"]) - through(current),
    }
    for width in (5e-5, 1.5e-4, 4e-4, 1e-3):
        terms[f"valve_deadband@{width:g}"] = through(np.clip(current, -width, width))
        worn = np.exp(-np.abs(current) / width)
        terms[f"valve_null_leakage@{width:g}"] = stiff * worn * (root[f"supply_{chamber}"] - root[f"{chamber}_tank"])
    for corner in LAGS:
        terms[f"valve_lag@{corner}"] = through(signal[f"lag{corner}"]) - through(current)
    for seconds in DROOPS:
        terms[f"supply_droop@{seconds:g}"] = from_supply * signal[f"droop{seconds:g}"]
    return terms


def motion_terms(signal: Signals, bench: Bench) -> Terms:
    """Terms of the acceleration [m/s^2]."""
    v, away = signal["velocity"], signal["position"] - bench.spring_rest_position
    force = bench.piston_area * (signal["pressure_a"] - bench.area_ratio * signal["pressure_b"])
    spring = bench.spring_stiffness * away
    slip = np.tanh(v / 1e-3)
    terms = {
        "friction_coulomb@positive": np.maximum(slip, 0.0),
        "friction_coulomb@negative": np.minimum(slip, 0.0),
        "friction_viscous": v,
        "force_offset|spring_rest|load_cell_bias": np.ones_like(v),
        "moving_mass": force - bench.viscous_friction * v - spring,
        "spring_stiffness": spring,
        "spring_hardening": away**3,
        "piston_area|load_cell_gain": force,
        "area_ratio": signal["pressure_b"],
    }
    for width in (0.01, 0.02, 0.03):
        terms[f"friction_stribeck@{width:g}"] = slip * np.exp(-np.square(v / width))
    for place in (3e-3, 5e-3, 7e-3):
        terms[f"end_cushion@{place:g}"] = np.maximum(away - place, 0.0)
        terms[f"end_cushion@-{place:g}"] = np.minimum(away + place, 0.0)
    for width in (5e-5, 2e-4, 5e-4):
        terms[f"backlash@{width:g}"] = np.clip(away, -width, width)
    return terms


def load_terms(spring: FloatArray, bench: Bench, step: float) -> Terms:
    """Terms of what the load cell reads [N], of the spring's force behind the nominal amplifier."""
    away = spring / bench.spring_stiffness
    terms = {
        "load_cell_gain|spring_stiffness": spring,
        "load_cell_bias|spring_rest": np.ones_like(spring),
        "spring_hardening": away**3,
        "sensor_lag": np.gradient(spring, step),
    }
    for width in (5e-5, 2e-4, 5e-4):
        terms[f"backlash@{width:g}"] = np.clip(away, -width, width)
    return terms


def hydraulic_terms(force: FloatArray, signal: Signals, step: float) -> Terms:
    """Terms of what the hydraulic load cell reads [N]."""
    return {
        "load_cell_gain|piston_area": force,
        "load_cell_bias|pressure_sensor_bias": np.ones_like(force),
        "area_ratio": signal["pressure_b"],
        "sensor_lag": np.gradient(force, step),
    }
