# SPDX-License-Identifier: Apache-2.0
"""The box: what its sensors read off the true states, and the force law's current from that."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.foreign_truth.equations import CELL, POSITION, PRESSURE_A, PRESSURE_B, flow_gain, spring

PERIOD = 1e-3
"""s."""


@njit
def sense(bench, state, noise, quantum, row):
    """Write hydraulic and load force, pressures and position into a row; noise is in N, N, Pa, Pa."""
    a, b, position = state[PRESSURE_A], state[PRESSURE_B], state[POSITION]
    hydraulic = bench.piston_area * (a - bench.area_ratio * b)
    load = state[CELL] if bench.load_cell_bandwidth > 0.0 else spring(bench, position)
    row[0] = bench.hydraulic_cell_gain * hydraulic + bench.hydraulic_cell_bias + noise[0]
    row[2] = bench.load_cell_gain * load + bench.load_cell_bias + noise[1]
    row[4], row[5] = a + bench.gauge_a_bias + noise[2], b + bench.gauge_b_bias + noise[3]
    row[6] = quantum * math.floor(position / quantum + 0.5) if quantum > 0.0 else position


@njit
def command(box, row, integral):
    """Write the force law's current into a row of readings and gains, and return the integral of K_i e [N/s].

    The bumpless form of protocol.md; with gains that stay as they are the paper's is the same.
    """
    a, b, position, velocity = row[4], row[5], row[6], row[7]
    area, ratio, modulus = box.piston_area, box.area_ratio, box.bulk_modulus
    volume_a = box.dead_volume_a + area * position
    volume_b = box.dead_volume_b + ratio * area * (box.stroke - position)
    drift = -modulus * area**2 * (1.0 / volume_a + ratio**2 / volume_b) * velocity
    error = row[10] - row[2]
    grown = integral + PERIOD * row[13] * error
    wanted = row[11] + row[12] * error + grown - drift
    high_a, high_b = (box.supply_pressure - a, b - box.tank_pressure) if wanted >= 0.0 else (
        a - box.tank_pressure, box.supply_pressure - b)  # fmt: skip
    edges = math.sqrt(max(high_a, 1e4)) / volume_a + ratio * math.sqrt(max(high_b, 1e4)) / volume_b
    row[9] = wanted / (modulus * flow_gain(box) * area * edges)
    row[8] = min(max(row[9], -box.valve_current_max), box.valve_current_max)
    row[14] = 3.0 if row[8] != row[9] else 1.0
    outward = (row[9] - row[8]) * row[13] * error > 0.0
    return integral if outward else grown
