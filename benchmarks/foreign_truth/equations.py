# SPDX-License-Identifier: Apache-2.0
"""The true bench as rates of nine states, set-valued dry friction apart from them, and the box.

The box: what its sensors read off the true states, and the force law's current from that.
"""

from __future__ import annotations

import math

from numba import njit

PRESSURE_A, PRESSURE_B, POSITION, VELOCITY, SPOOL, SPOOL_RATE, CELL, CELL_RATE, DROOP = range(9)
STATES = 9
ATMOSPHERE, POLYTROPIC = 101325.0, 1.4


@njit
def root(difference):
    """Signed square root."""
    return math.sqrt(difference) if difference >= 0.0 else -math.sqrt(-difference)


@njit
def flow_gain(bench):
    """m3/s per A and sqrt(Pa), from the valve's rating of both edges together."""
    return bench.valve_nominal_flow / (bench.valve_nominal_current * math.sqrt(bench.valve_nominal_pressure_drop / 2.0))


@njit
def outside(value, half):
    """What is beyond a dead zone of this half width."""
    if value > half:
        return value - half
    return value + half if value < -half else 0.0


@njit
def spring(bench, position):
    """Force of the load [N]."""
    stretch = outside(position - bench.spring_rest_position, 0.5 * bench.backlash)
    return bench.spring_stiffness * stretch + bench.spring_cubic * stretch**3


@njit
def stiffness(bench, pressure):
    """Bulk modulus [Pa] of oil with air in it: volumes of both shrink, each by its own law."""
    if bench.air <= 0.0:
        return bench.bulk_modulus
    absolute = max(pressure + ATMOSPHERE, 2e4)
    gas = bench.air * (ATMOSPHERE / absolute) ** (1.0 / POLYTROPIC)
    oil = (1.0 - bench.air) * math.exp(-(absolute - ATMOSPHERE) / bench.bulk_modulus)
    return (oil + gas) / (oil / bench.bulk_modulus + gas / (POLYTROPIC * absolute))


@njit
def opening(bench, time, spool):
    """Current [A] that a perfect valve would need for this spool's flow."""
    drawn = outside(spool + bench.valve_offset, bench.valve_overlap)
    drawn *= bench.valve_gain * (1.0 + bench.valve_gain_drift * time)
    return drawn * bench.valve_asymmetry if drawn < 0.0 else drawn


@njit
def spool_rates(bench, current, state, out):
    """Write the spool's rates and return where it stands [A]."""
    if bench.spool_bandwidth <= 0.0:
        out[SPOOL] = out[SPOOL_RATE] = 0.0
        return current
    corner, rate = 2.0 * math.pi * bench.spool_bandwidth, state[SPOOL_RATE]
    out[SPOOL] = rate
    out[SPOOL_RATE] = corner**2 * (current - state[SPOOL]) - 2.0 * bench.spool_damping * corner * rate
    return state[SPOOL]


@njit
def rates(bench, time, current, state, out):
    """Time derivatives of the states, dry friction left out."""
    a, b, position, velocity = state[PRESSURE_A], state[PRESSURE_B], state[POSITION], state[VELOCITY]
    area, area_b, tank = bench.piston_area, bench.area_ratio * bench.piston_area, bench.tank_pressure
    drawn = opening(bench, time, spool_rates(bench, current, state, out))
    supply, gain = bench.supply_pressure - state[DROOP], flow_gain(bench)
    if drawn >= 0.0:
        into_a, out_of_b = gain * drawn * root(supply - a), gain * drawn * root(b - tank)
    else:
        into_a, out_of_b = gain * drawn * root(a - tank), gain * drawn * root(supply - b)
    from_supply = into_a if drawn >= 0.0 else -out_of_b
    out[DROOP] = 0.0
    if bench.droop_resistance > 0.0:
        out[DROOP] = (bench.droop_resistance * from_supply - state[DROOP]) / bench.droop_time
    across = bench.leak_internal * (a - b)
    volume_a = bench.dead_volume_a + area * position
    volume_b = bench.dead_volume_b + area_b * (bench.stroke - position)
    gained_a = into_a - across - bench.leak_a * (a - tank) - area * velocity
    gained_b = area_b * velocity - out_of_b + across - bench.leak_b * (b - tank)
    out[PRESSURE_A] = stiffness(bench, a) / volume_a * gained_a
    out[PRESSURE_B] = stiffness(bench, b) / volume_b * gained_b
    load = spring(bench, position)
    force = area * a - area_b * b - bench.viscous_friction * velocity - load + bench.force_offset
    if bench.cushion_stiffness > 0.0 and position > bench.cushion_position:
        force -= bench.cushion_stiffness * (position - bench.cushion_position)
    out[POSITION], out[VELOCITY] = velocity, force / bench.moving_mass
    corner = 2.0 * math.pi * bench.load_cell_bandwidth
    out[CELL] = state[CELL_RATE]
    out[CELL_RATE] = corner**2 * (load - state[CELL]) - math.sqrt(2.0) * corner * state[CELL_RATE]


@njit
def rub(bench, state, seconds):
    """Dry friction for a while, exactly: it slows the mass down and then holds it, and never turns it round."""
    force = bench.coulomb
    if bench.stribeck > 0.0:
        force += bench.stribeck * math.exp(-((state[VELOCITY] / bench.stribeck_velocity) ** 2))
    if force > 0.0:
        state[VELOCITY] = outside(state[VELOCITY], seconds * force / bench.moving_mass)


PERIOD = 1e-3
"""s."""


@njit
def sense(bench, state, noise, quantum, row):
    """Write hydraulic and load force, pressures and position into a row; noise is in N, N, Pa, Pa."""
    a, b, position = state[PRESSURE_A], state[PRESSURE_B], state[POSITION]
    load = state[CELL] if bench.load_cell_bandwidth > 0.0 else spring(bench, position)
    row[0] = bench.piston_area * (a - bench.area_ratio * b) + noise[0]
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
