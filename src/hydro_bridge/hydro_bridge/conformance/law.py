# SPDX-License-Identifier: Apache-2.0
"""Independent implementation of the force law of protocol.md and physics.md: u_nom for a box's measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import sqrt
from typing import Any

FLOOR_SHARE = 0.1
"""Lower bound of g, relative to g of the bench at rest."""


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
    """Return g_min [N/s/A], from the bench at rest with p_a = alpha p_b, p_a + p_b = p_s and the spring relaxed."""
    alpha = bench["area_ratio"]
    pressure_b = bench["supply_pressure"] / (1.0 + alpha)
    return FLOOR_SHARE * _gain(bench, bench["spring_rest_position"], (alpha * pressure_b, pressure_b), 1.0)


def nominal_current(
    bench: Mapping[str, Any], values: Mapping[str, float], integral: float, force: str, scales: Sequence[float] = (1, 1)
) -> float:
    """Return u_nom [A] of one STATE, by field name, where `reference_force` and its rate are f_c and f_c'.

    `integral` is I [N/s], `force` the name of the followed force, `scales` are C_1 and C_2.
    """
    position = min(max(values["piston_position"], 0.0), bench["stroke"])
    volume_a, volume_b = _volumes(bench, position)
    stiffness = bench["bulk_modulus"] * bench["piston_area"] ** 2 * (1 / volume_a + bench["area_ratio"] ** 2 / volume_b)
    error = values["reference_force"] - values[force]
    wanted = values["reference_force_rate"] + values["proportional_gain"] * error + integral
    driven = wanted + scales[0] * stiffness * values["piston_velocity"]
    gain = scales[1] * _gain(bench, position, (values["pressure_a"], values["pressure_b"]), driven)
    return driven / max(gain, floor(bench))
