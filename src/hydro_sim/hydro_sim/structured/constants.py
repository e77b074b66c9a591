# SPDX-License-Identifier: Apache-2.0
"""Learned constants of `physics`: initial value, unit, and scale of the optimizer's variable.

A constant that must stay positive is start * exp(theta); any other is start + step * theta. Start values come from the
bench file where it has them; the others are orders of magnitude from textbooks, not this bench's values.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING


@dataclass(frozen=True, kw_only=True)
class Constant:
    """One entry of `c`."""

    name: str
    unit: str
    start: float
    step: float | None = None
    """None: start * exp(theta), theta in units of 1; else start + step * theta."""
    learned: bool = True


def constants(bench: Bench) -> tuple[Constant, ...]:
    """Return all constants, in the order of `physics`."""
    area_ratio, gain = bench.area_ratio, bench.valve_gain
    bandwidth = bench.load_cell_bandwidth or 100.0
    return (
        Constant(name="bulk_modulus", unit="Pa", start=bench.bulk_modulus, learned=False),
        Constant(name="piston_area", unit="m2", start=bench.piston_area),
        Constant(name="area_ratio", unit="-", start=area_ratio),
        Constant(name="dead_volume_a", unit="m3", start=bench.dead_volume_a),
        Constant(name="dead_volume_b", unit="m3", start=bench.dead_volume_b),
        Constant(name="supply_pressure", unit="Pa", start=bench.supply_pressure),
        Constant(name="tank_pressure", unit="Pa", start=bench.tank_pressure, step=1e5),
        Constant(name="valve_gain_a_positive", unit="m3/s/A/sqrt(Pa)", start=gain),
        Constant(name="valve_gain_a_negative", unit="m3/s/A/sqrt(Pa)", start=gain),
        Constant(name="valve_gain_b_positive", unit="m3/s/A/sqrt(Pa)", start=gain),
        Constant(name="valve_gain_b_negative", unit="m3/s/A/sqrt(Pa)", start=gain),
        Constant(name="valve_offset", unit="A", start=0.0, step=1e-4),
        Constant(name="leakage_internal", unit="m3/s/Pa", start=0.0, step=1e-13),
        Constant(name="moving_mass", unit="kg", start=bench.moving_mass),
        Constant(name="viscous_friction", unit="N s/m", start=max(bench.viscous_friction, 1.0)),
        Constant(name="spring_stiffness", unit="N/m", start=bench.spring_stiffness),
        Constant(name="spring_rest_position", unit="m", start=bench.spring_rest_position, step=1e-3),
        Constant(name="spool_frequency", unit="rad/s", start=2.0 * pi * 80.0),
        Constant(name="spool_damping", unit="-", start=1.0),
        Constant(name="load_cell_frequency", unit="rad/s", start=2.0 * pi * bandwidth),
        Constant(name="load_cell_damping", unit="-", start=LOAD_CELL_DAMPING),
        Constant(name="friction_coulomb", unit="N", start=5.0),
        Constant(name="friction_stribeck", unit="N", start=2.0),
        Constant(name="stribeck_velocity", unit="m/s", start=0.02),
        Constant(name="bristle_stiffness", unit="N/m", start=2e5),
        Constant(name="bristle_damping", unit="N s/m", start=100.0),
        Constant(name="bristle_damping_velocity", unit="m/s", start=0.02),
        Constant(name="force_h_gain", unit="-", start=1.0, learned=False),
        Constant(name="force_h_bias", unit="N", start=0.0, step=1.0),
        Constant(name="force_l_gain", unit="-", start=1.0, learned=False),
        Constant(name="force_l_bias", unit="N", start=0.0, step=1.0, learned=False),  # as good as a shift of the rest
        Constant(name="stroke", unit="m", start=bench.stroke, learned=False),
    )


def values(table: tuple[Constant, ...], theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The constants c and dc/dtheta (zero for what is not learned), at theta, all of shape (len(table),)."""
    start = np.array([entry.start for entry in table])
    step = np.array([np.nan if entry.step is None else entry.step for entry in table])
    learned = np.array([entry.learned for entry in table])
    positive = np.isnan(step)
    c = np.where(positive, start * np.exp(theta), start + np.where(positive, 0.0, step) * theta)
    return c, np.where(learned, np.where(positive, c, step), 0.0)
