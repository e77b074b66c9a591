# SPDX-License-Identifier: Apache-2.0
"""Parameters of a bench file and of the force law's bench, and the states of a certified region."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_core.signals import FloatArray
from hydro_core.valve_overlap import valve_overlap
from hydro_filter.model.sample import POSITION, PRESSURE_A, PRESSURE_B, VELOCITY
from hydro_filter.model.terms import LOAD_CELL_LAG, VALVE_LAG, dry_friction, parameters_of
from hydro_sim.model.bench import Bench
from hydro_sim.model.effects import catalogue, parameter_corrections
from hydro_sim.model.equations import LOAD_CELL_DAMPING
from hydro_sim.model.sensors import Sensors

Bounds = tuple[float, float]

TOLERANCED_PARAMETERS = (
    "valve_gain", "bulk_modulus", "dead_volume_a", "dead_volume_b", "spring_stiffness", "supply_pressure",
    "spool_bandwidth",
)  # fmt: skip
"""Parameters of a bench with a tolerance, as ratios to those of the bench file; `dead_time` has one in s."""
SUPPORTED_EFFECTS = (
    "valve_lag", "sensor_lag sensor=load_force", "leakage_internal", "bulk_modulus", "valve_gain", "valve_offset",
    "friction_coulomb", "friction_coulomb form=directional", "friction_stribeck", "friction_presliding",
    "valve_deadband", "valve_deadband form=lopsided", "force_offset",
    *(effect.id for effect in parameter_corrections.EFFECTS),
)  # fmt: skip
"""Effects that the proof supports: lags, leakage, disturbances, null shifts, corrections of the bench's parameters."""


def bench_parameters(model: Bench, bench: Bench) -> tuple[dict[str, float], dict[str, float]]:
    """Return the parameters of a bench file and of the force law's bench by name, SI units; bandwidths in Hz.

    Raises ValueError: the file has an effect that the proof does not support, or lacks one that it needs.
    """
    if model.closures:
        raise ValueError("the proof has no place for closures")
    found: dict[str, dict[str, float]] = {}
    for effect in model.effects:
        if (label := catalogue.label(effect)) in found:
            raise ValueError(f"the proof has no place for a second {label}")
        found[label] = parameters_of(effect)
    for label in found:
        if label not in SUPPORTED_EFFECTS:
            raise ValueError(f"the proof has no place for {label}")
    if VALVE_LAG not in found:
        raise ValueError("the proof needs a valve_lag of second order in the bench file")
    own_cell = model.without_effects().load_cell_bandwidth
    cell = found.get(LOAD_CELL_LAG) or {"bandwidth": own_cell or 0.0, "damping": LOAD_CELL_DAMPING}
    if not cell["bandwidth"]:
        raise ValueError("the proof needs the load cell's bandwidth in the bench file")
    record = model.constants()[0]
    values = {name: float(record[name]) for name in record.dtype.names}
    for name in ("bulk_modulus", "valve_gain"):  # their corrections are terms of the model, not in `constants`
        values[name] *= found.get(name, {}).get("ratio", 1.0)
    overlap = valve_overlap(model.effects)
    ours = {
        name: values[name]
        for name in (
            "bulk_modulus", "piston_area", "area_ratio", "stroke", "supply_pressure", "tank_pressure", "valve_gain",
            "dead_volume_a", "dead_volume_b", "moving_mass", "viscous_friction", "spring_stiffness",
            "spring_rest_position",
        )
    }  # fmt: skip
    ours |= {
        "spool_bandwidth": found[VALVE_LAG]["bandwidth"], "spool_damping": found[VALVE_LAG]["damping"],
        "cell_bandwidth": cell["bandwidth"], "cell_damping": cell["damping"],
        "leakage": found.get("leakage_internal", {}).get("coefficient", 0.0), "dry_friction": dry_friction(model),
        "overlap": max(overlap["back"], overlap["out"]), "dead_time": catalogue.total_delay(model.effects),
        "velocity_memory": float(Sensors().constants()[0]["velocity_memory"]),
    }  # fmt: skip
    record = bench.constants()[0]
    law = {
        name: float(record[name])
        for name in ("bulk_modulus", "supply_pressure", "valve_gain", "dead_volume_a", "dead_volume_b")
    }
    for name in ("piston_area", "area_ratio", "stroke", "tank_pressure"):
        if float(record[name]) != ours[name]:
            raise ValueError(f"the proof needs the law's {name} to be the bench's")
    return ours, law


STATE_NAMES = (
    "position", "velocity", "pressure_a", "pressure_b", "opening", "opening_rate", "opening_error", "pressure_a_rate",
    "pressure_b_rate", "gain_drift",
)  # fmt: skip
"""Columns of `region_states`: m, m/s, Pa, Pa, A, A/s, A, Pa/s, Pa/s, 1/s."""


def region_states(bench: Mapping[str, float], x: FloatArray, valve: FloatArray) -> FloatArray:
    """Return the region's states, shape (n, 10), columns `STATE_NAMES`.

    Parameters
    ----------
    bench
        Parameters of the bench file (`bench_parameters`).
    x
        Measured states, shape (n, 8).
    valve
        The spool's opening [A], its rate [A/s], and u_nom with the null shifts [A], shape (n, 3).
    """
    position, velocity, p_a, p_b = x[:, POSITION], x[:, VELOCITY], x[:, PRESSURE_A], x[:, PRESSURE_B]
    opening, rate, nominal = valve.T
    area, area_b = bench["piston_area"], bench["piston_area"] * bench["area_ratio"]
    volume_a, volume_b = (
        bench["dead_volume_a"] + area * position,
        bench["dead_volume_b"] + area_b * (bench["stroke"] - position),
    )
    out, side = opening >= 0.0, np.where(opening >= 0.0, 1.0, -1.0)
    drop_a = np.where(out, bench["supply_pressure"] - p_a, p_a - bench["tank_pressure"])
    drop_b = np.where(out, p_b - bench["tank_pressure"], bench["supply_pressure"] - p_b)
    root_a, root_b = np.sqrt(np.maximum(drop_a, 1.0)), np.sqrt(np.maximum(drop_b, 1.0))
    leak = bench["leakage"] * (p_a - p_b)
    rate_a = bench["bulk_modulus"] / volume_a * (bench["valve_gain"] * root_a * opening - area * velocity - leak)
    rate_b = bench["bulk_modulus"] / volume_b * (area_b * velocity + leak - bench["valve_gain"] * root_b * opening)
    g_a, g_b = area * root_a / volume_a, area_b * root_b / volume_b
    drift_a = -0.5 * side * rate_a / drop_a - area * velocity / volume_a
    drift_b = 0.5 * side * rate_b / drop_b + area_b * velocity / volume_b
    drift = (g_a * drift_a + g_b * drift_b) / (g_a + g_b)
    return np.column_stack((position, velocity, p_a, p_b, opening, rate, nominal - opening, rate_a, rate_b, drift))


def containment_share(states: Mapping[str, Bounds], samples: FloatArray) -> float:
    """Return the share of samples, shape (n, 10), within the region's box."""
    low, high = np.array([states[name] for name in STATE_NAMES]).T
    return float(1.0 - np.any((samples < low) | (samples > high), axis=1).mean())
