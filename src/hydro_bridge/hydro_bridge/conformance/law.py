# SPDX-License-Identifier: Apache-2.0
"""The force law by protocol.md and physics.md, written anew: what u_nom must be for what a box measured."""

from __future__ import annotations

from collections.abc import Mapping
from math import sqrt
from typing import Any

FLOOR_SHARE = 0.1
"""Smallest g that is believed, over that of the still bench."""


def _gain(bench: Mapping[str, Any], position: float, pressures: tuple[float, float], opening: float) -> float:
    """g [N/s/A]."""
    area, alpha = bench["piston_area"], bench["area_ratio"]
    flow = bench["valve_nominal_flow"] / bench["valve_nominal_current"] / sqrt(bench["valve_nominal_pressure_drop"] / 2)
    high, low = bench["supply_pressure"], bench["tank_pressure"]
    drops = (high - pressures[0], pressures[1] - low) if opening >= 0 else (pressures[0] - low, high - pressures[1])
    a, b = (flow * (sqrt(drop) if drop >= 0 else -sqrt(-drop)) for drop in drops)
    volume_a, volume_b = _volumes(bench, position)
    result: float = bench["bulk_modulus"] * area * (a / volume_a + alpha * b / volume_b)
    return result


def _volumes(bench: Mapping[str, Any], position: float) -> tuple[float, float]:
    area, alpha = bench["piston_area"], bench["area_ratio"]
    return (
        bench["dead_volume_a"] + area * position,
        bench["dead_volume_b"] + alpha * area * (bench["stroke"] - position),
    )


def floor(bench: Mapping[str, Any]) -> float:
    """g_min [N/s/A]: of the still bench with p_a = alpha p_b and p_a + p_b = p_s, the spring relaxed."""
    alpha = bench["area_ratio"]
    pressure_b = bench["supply_pressure"] / (1.0 + alpha)
    return FLOOR_SHARE * _gain(bench, bench["spring_rest_position"], (alpha * pressure_b, pressure_b), 1.0)


def nominal_current(bench: Mapping[str, Any], values: Mapping[str, float], integral: float, force: str) -> float:
    """u_nom [A] of one STATE, by the names of its fields; `integral` is I [N/s], `force` the one that is followed."""
    position = min(max(values["piston_position"], 0.0), bench["stroke"])
    volume_a, volume_b = _volumes(bench, position)
    stiffness = bench["bulk_modulus"] * bench["piston_area"] ** 2 * (1 / volume_a + bench["area_ratio"] ** 2 / volume_b)
    error = values["reference_force"] - values[force]
    wanted = values["reference_force_rate"] + values["proportional_gain"] * error + integral
    driven = wanted + stiffness * values["piston_velocity"]
    gain = _gain(bench, position, (values["pressure_a"], values["pressure_b"]), driven)
    return driven / max(gain, floor(bench))
