# SPDX-License-Identifier: Apache-2.0
"""The bench's equations: servo valve, two oil chambers, mass, spring, load-cell amplifier. Compiled, on plain numbers.

Everywhere here `bench` is one record of `model.bench.BENCH_DTYPE` (`Bench.constants()[0]`), the physical state is::

    y = [ p_a   p_b   x_p   x_p'   f_l behind the load cell's amplifier   its rate ]
          Pa    Pa    m     m/s    N                                      N/s
          0     1     2     3      4                                      5

    p_a' = beta/V_a (q_a - A_p x_p')           V_a = V_dead_a + A_p x_p
    p_b' = beta/V_b (alpha A_p x_p' - q_b)     V_b = V_dead_b + alpha A_p (L_c - x_p)
    m x_p'' = f_h - b x_p' - f_l - f_stop      f_h = A_p p_a - alpha A_p p_b,  f_l = k_s (x_p - x_rest)

Source: paper eq. q13-q15 and q4, physics.md; `input_gain` carries the erratum's plus sign.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from hydro_bridge.signals import FloatArray

STATES = 6
"""Length of the physical state y."""

LOAD_CELL_DAMPING = math.sqrt(0.5)
"""Damping of the load cell's amplifier: Butterworth, so that `load_cell_bandwidth` is where it has lost 3 dB."""

SUBSTEPS = 20
"""Runge-Kutta steps per sample: 50 us, a 220th of a period of the 90 Hz mass-on-oil mode."""

STOP_STIFFNESS = 1e7
"""Stiffness [N/m] of the end stops: the largest hydraulic force presses 0.3 mm into them."""

STOP_DAMPING = 4e3
"""Damping [N s/m] of the end stops while pressed, about critical: the piston does not bounce."""


@njit(cache=True)
def signed_sqrt(pressure_drop: float) -> float:
    """sqrt of a pressure drop [Pa], odd: flow through a land reverses with the drop."""
    return math.copysign(math.sqrt(abs(pressure_drop)), pressure_drop)


@njit(cache=True)
def volumes(bench, position):
    """Oil volumes V_a, V_b [m3] at piston position [m]."""
    rest_of_stroke = bench.stroke - position
    volume_a = bench.dead_volume_a + bench.piston_area * position
    return volume_a, bench.dead_volume_b + bench.area_ratio * bench.piston_area * rest_of_stroke


@njit(cache=True)
def flow_gains(bench, pressure_a, pressure_b, opening):
    """q_a/u and q_b/u [m3/s/A] of an opened valve; `opening`: any current of the same sign."""
    if opening >= 0.0:
        drop_a, drop_b = bench.supply_pressure - pressure_a, pressure_b - bench.tank_pressure
    else:
        drop_a, drop_b = pressure_a - bench.tank_pressure, bench.supply_pressure - pressure_b
    return bench.valve_gain * signed_sqrt(drop_a), bench.valve_gain * signed_sqrt(drop_b)


@njit(cache=True)
def chamber_flows(bench, pressure_a, pressure_b, current):
    """Flow q_a into chamber A and q_b out of chamber B [m3/s] at valve current [A]."""
    gain_a, gain_b = flow_gains(bench, pressure_a, pressure_b, current)
    return gain_a * current, gain_b * current


@njit(cache=True)
def pressure_rates(bench, pressure_a, pressure_b, position, velocity, current):
    """p_a', p_b' [Pa/s]: what flows in and is not displaced, compresses."""
    flow_a, flow_b = chamber_flows(bench, pressure_a, pressure_b, current)
    volume_a, volume_b = volumes(bench, position)
    swept = bench.piston_area * velocity
    rate_a = bench.bulk_modulus / volume_a * (flow_a - swept)
    return rate_a, bench.bulk_modulus / volume_b * (bench.area_ratio * swept - flow_b)


@njit(cache=True)
def velocity_term(bench, position, velocity):
    """h [N/s] (eq. q14): effect of the motion on the hydraulic force."""
    volume_a, volume_b = volumes(bench, position)
    stiffness = bench.bulk_modulus * bench.piston_area**2 * (1.0 / volume_a + bench.area_ratio**2 / volume_b)
    return -stiffness * velocity


@njit(cache=True)
def input_gain(bench, position, pressure_a, pressure_b, opening):
    """g [N/s/A] (eq. q15 with a plus, see the erratum in physics.md), for currents with the sign of `opening`."""
    volume_a, volume_b = volumes(bench, position)
    gain_a, gain_b = flow_gains(bench, pressure_a, pressure_b, opening)
    return bench.bulk_modulus * bench.piston_area * (gain_a / volume_a + bench.area_ratio * gain_b / volume_b)


@njit(cache=True)
def hydraulic_force(bench, pressure_a, pressure_b):
    """f_h [N], positive outwards."""
    return bench.piston_area * (pressure_a - bench.area_ratio * pressure_b)


@njit(cache=True)
def load_force(bench, position):
    """f_l [N] of the spring on its load cell, positive when pressed."""
    return bench.spring_stiffness * (position - bench.spring_rest_position)


@njit(cache=True)
def stop_force(bench, position, velocity):
    """Force [N] against the piston from an end stop; it pushes back and never pulls."""
    if position < 0.0:
        return min(STOP_STIFFNESS * position + STOP_DAMPING * velocity, 0.0)
    if position > bench.stroke:
        return max(STOP_STIFFNESS * (position - bench.stroke) + STOP_DAMPING * velocity, 0.0)
    return 0.0


@njit(cache=True)
def rates(bench, y, current, out):
    """Write y' at a valve current [A] into `out`, shape (6,)."""
    out[0], out[1] = pressure_rates(bench, y[0], y[1], y[2], y[3], current)
    force = load_force(bench, y[2])
    driven = hydraulic_force(bench, y[0], y[1]) - stop_force(bench, y[2], y[3])
    out[2] = y[3]
    out[3] = (driven - bench.viscous_friction * y[3] - force) / bench.moving_mass
    omega = bench.load_cell_omega
    out[4] = y[5]
    out[5] = omega * (omega * (force - y[4]) - 2.0 * LOAD_CELL_DAMPING * y[5])


@njit(cache=True)
def advance(bench, y, current, duration, steps):
    """Integrate y, shape (6,), in place over `duration` [s] at a held current [A] by `steps` steps of classic RK4.

    Pressures are kept from falling below zero: the oil cavitates there, and the volume it then lacks is not accounted
    for. An ideal load cell (omega 0) shows the spring's force as it is.
    """
    step = duration / steps
    slopes = np.empty((4, STATES))
    probe = np.empty(STATES)
    for _ in range(steps):
        rates(bench, y, current, slopes[0])
        for stage in range(1, 4):
            reach = step if stage == 3 else 0.5 * step
            for i in range(STATES):
                probe[i] = y[i] + reach * slopes[stage - 1, i]
            rates(bench, probe, current, slopes[stage])
        for i in range(STATES):
            y[i] += step / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
        y[0] = max(y[0], 0.0)
        y[1] = max(y[1], 0.0)
    if bench.load_cell_omega == 0.0:
        y[4] = load_force(bench, y[2])


def rest_state(bench: np.void) -> FloatArray:
    """The physical state y, shape (6,), of a still bench with a relaxed spring and p_a + p_b = p_s."""
    pressure_b = bench["supply_pressure"] / (1.0 + bench["area_ratio"])
    return np.array([bench["area_ratio"] * pressure_b, pressure_b, bench["spring_rest_position"], 0.0, 0.0, 0.0])
