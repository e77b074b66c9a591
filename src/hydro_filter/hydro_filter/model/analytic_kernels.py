# SPDX-License-Identifier: Apache-2.0
"""Compiled analytic bench of `dynamics`: x' = f(x, u), with exact A and B written out.

Row by row as in `dynamics`. With F(x, u) = h + g u, f_h' of eq. q13, row f_h'' takes the slopes of F, times how x_p,
x_p', p_a, p_b change, and the second derivatives of F. Source: paper eq. q13-q15 with physics.md's erratum.
"""

from __future__ import annotations

import math

from numba import njit

from hydro_filter.model.state import (
    HYDRAULIC_FORCE,
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    STATES,
    VELOCITY,
)
from hydro_sim.model import equations as eq
from hydro_sim.model.hydraulics import flow_gains, input_gain, pressure_rates, stiffnesses, velocity_term

SMALLEST_DROP = 1e3
"""Pa; the slope of a square root is taken no nearer to zero pressure drop than this: it is infinite there."""


@njit(cache=True)
def acceleration(bench, state):
    """x_p'' [m/s^2]."""
    spring = bench.spring_stiffness * (state[POSITION] - bench.spring_rest_position)
    return (state[HYDRAULIC_FORCE] - bench.viscous_friction * state[VELOCITY] - spring) / bench.moving_mass


@njit(cache=True)
def state_rate(constants, state, current, out):
    """Write x' into `out`, shape (8,); `constants` of shape (1,)."""
    bench = constants[0]
    pressure_a, pressure_b = state[PRESSURE_A], state[PRESSURE_B]
    position, velocity = state[POSITION], state[VELOCITY]
    gain = input_gain(bench, position, pressure_a, pressure_b, current)
    out[HYDRAULIC_FORCE] = velocity_term(bench, position, velocity) + gain * current
    out[LOAD_FORCE] = state[LOAD_FORCE_RATE]
    out[LOAD_FORCE_RATE] = bench.spring_stiffness * acceleration(bench, state)
    rate_a, rate_b = pressure_rates(bench, pressure_a, pressure_b, position, velocity, current)
    out[PRESSURE_A], out[PRESSURE_B] = rate_a, rate_b
    out[POSITION] = velocity
    out[VELOCITY] = acceleration(bench, state)
    slopes = force_rate_slopes(bench, state, current)
    along = slopes[0] * velocity + slopes[1] * out[VELOCITY]
    out[HYDRAULIC_FORCE_RATE] = along + slopes[2] * rate_a + slopes[3] * rate_b


@njit(cache=True)
def land_slopes(bench, pressure_a, pressure_b, opening):
    """d(q_a/u)/dp_a and d(q_b/u)/dp_b of `hydraulics.flow_gains`, then the second derivatives."""
    out, back = eq.edge_drops(bench.supply_pressure, bench.tank_pressure, pressure_a, pressure_b)
    (drop_a, drop_b), sign = (out, -1.0) if opening >= 0.0 else (back, 1.0)
    root_a = math.sqrt(max(abs(drop_a), SMALLEST_DROP))
    root_b = math.sqrt(max(abs(drop_b), SMALLEST_DROP))
    first_a, first_b = 0.5 * sign * bench.valve_gain / root_a, -0.5 * sign * bench.valve_gain / root_b
    second_a = -0.25 * math.copysign(bench.valve_gain, drop_a) / root_a**3
    second_b = -0.25 * math.copysign(bench.valve_gain, drop_b) / root_b**3
    return first_a, first_b, second_a, second_b


@njit(cache=True)
def force_rate_slopes(bench, state, current):
    """Slopes of F(x, u) = h + g u, f_h' of eq. q13: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b."""
    area, ratio = bench.piston_area, bench.area_ratio
    volume_a, volume_b = eq.volumes(bench, state[POSITION])
    gain_a, gain_b = flow_gains(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    slope_a, slope_b, _, _ = land_slopes(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    scale = bench.bulk_modulus * area
    # V_a' = A_p and V_b' = -alpha A_p with respect to x_p: an inverse volume squared for each derivative
    swept = -area * state[VELOCITY]
    flow_a, flow_b = gain_a * current + swept, gain_b * current + ratio * swept
    by_position = scale * area * (-flow_a / volume_a**2 + ratio**2 * flow_b / volume_b**2)
    by_velocity = -scale * area * (1.0 / volume_a + ratio**2 / volume_b)
    return by_position, by_velocity, scale * slope_a * current / volume_a, scale * ratio * slope_b * current / volume_b


@njit(cache=True)
def linearize(constants, state, current, state_matrix, input_vector):
    """Write A, shape (8, 8), and B, shape (8,); `constants` of shape (1,)."""
    bench = constants[0]
    state_matrix[:] = 0.0
    input_vector[:] = 0.0
    slopes = force_rate_slopes(bench, state, current)
    gain = input_gain(bench, state[POSITION], state[PRESSURE_A], state[PRESSURE_B], current)
    _chambers(bench, state, current, state_matrix, input_vector)
    _motion(bench, state_matrix)
    by_position, by_velocity, by_a, by_b = slopes
    state_matrix[HYDRAULIC_FORCE, POSITION] = by_position
    state_matrix[HYDRAULIC_FORCE, VELOCITY] = by_velocity
    state_matrix[HYDRAULIC_FORCE, PRESSURE_A] = by_a
    state_matrix[HYDRAULIC_FORCE, PRESSURE_B] = by_b
    input_vector[HYDRAULIC_FORCE] = gain
    # f_h'' = slopes . (x_p', x_p'', p_a', p_b'): first the slopes times how those four change, ...
    for column in range(STATES):
        state_matrix[HYDRAULIC_FORCE_RATE, column] = (
            by_velocity * state_matrix[VELOCITY, column]
            + by_a * state_matrix[PRESSURE_A, column]
            + by_b * state_matrix[PRESSURE_B, column]
        )
    state_matrix[HYDRAULIC_FORCE_RATE, VELOCITY] += by_position
    input_vector[HYDRAULIC_FORCE_RATE] = by_a * input_vector[PRESSURE_A] + by_b * input_vector[PRESSURE_B]
    # ... then how the slopes change, times those four
    _bend(bench, state, current, state_matrix, input_vector)


@njit(cache=True)
def _chambers(bench, state, current, state_matrix, input_vector):
    """Rows p_a', p_b'."""
    area, ratio, velocity = bench.piston_area, bench.area_ratio, state[VELOCITY]
    volume_a, volume_b = eq.volumes(bench, state[POSITION])
    gain_a, gain_b = flow_gains(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    slope_a, slope_b, _, _ = land_slopes(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    soft_a, soft_b = stiffnesses(bench, state[POSITION])
    rate_a, rate_b = eq.pressure_rates(bench, (soft_a, soft_b), (gain_a * current, -gain_b * current), velocity)
    state_matrix[PRESSURE_A, PRESSURE_A] = soft_a * slope_a * current
    state_matrix[PRESSURE_A, POSITION] = -area / volume_a * rate_a
    state_matrix[PRESSURE_A, VELOCITY] = -soft_a * area
    state_matrix[PRESSURE_B, PRESSURE_B] = -soft_b * slope_b * current
    state_matrix[PRESSURE_B, POSITION] = ratio * area / volume_b * rate_b
    state_matrix[PRESSURE_B, VELOCITY] = soft_b * ratio * area
    input_vector[PRESSURE_A] = soft_a * gain_a
    input_vector[PRESSURE_B] = -soft_b * gain_b


@njit(cache=True)
def _motion(bench, state_matrix):
    """Rows f_l', f_l'', x_p', x_p''."""
    stiffness, mass = bench.spring_stiffness, bench.moving_mass
    state_matrix[LOAD_FORCE, LOAD_FORCE_RATE] = 1.0
    state_matrix[POSITION, VELOCITY] = 1.0
    state_matrix[VELOCITY, HYDRAULIC_FORCE] = 1.0 / mass
    state_matrix[VELOCITY, POSITION] = -stiffness / mass
    state_matrix[VELOCITY, VELOCITY] = -bench.viscous_friction / mass
    for column in range(STATES):
        state_matrix[LOAD_FORCE_RATE, column] = stiffness * state_matrix[VELOCITY, column]


@njit(cache=True)
def _bend(bench, state, current, state_matrix, input_vector):
    """Add to row f_h'' what the second derivatives of F = h + g u contribute."""
    area, ratio, velocity = bench.piston_area, bench.area_ratio, state[VELOCITY]
    pressure_a, pressure_b, position = state[PRESSURE_A], state[PRESSURE_B], state[POSITION]
    volume_a, volume_b = eq.volumes(bench, position)
    gain_a, gain_b = flow_gains(bench, pressure_a, pressure_b, current)
    slope_a, slope_b, second_a, second_b = land_slopes(bench, pressure_a, pressure_b, current)
    rate_a, rate_b = pressure_rates(bench, pressure_a, pressure_b, position, velocity, current)
    scale = bench.bulk_modulus * area
    flow_a, flow_b = gain_a * current - area * velocity, gain_b * current - ratio * area * velocity
    by_position_twice = 2.0 * scale * area**2 * (flow_a / volume_a**3 + ratio**3 * flow_b / volume_b**3)
    by_position_velocity = scale * area**2 * (1.0 / volume_a**2 - ratio**3 / volume_b**2)
    to_a, to_b = -scale * area / volume_a**2, scale * area * ratio**2 / volume_b**2  # d/dx_p of scale/V
    row = state_matrix[HYDRAULIC_FORCE_RATE]
    row[POSITION] += by_position_twice * velocity + by_position_velocity * acceleration(bench, state)
    row[POSITION] += (to_a * slope_a * rate_a + to_b * slope_b * rate_b) * current
    row[VELOCITY] += by_position_velocity * velocity
    row[PRESSURE_A] += (to_a * slope_a * velocity + scale * second_a / volume_a * rate_a) * current
    row[PRESSURE_B] += (to_b * slope_b * velocity + scale * ratio * second_b / volume_b * rate_b) * current
    input_vector[HYDRAULIC_FORCE_RATE] += (to_a * gain_a + to_b * gain_b) * velocity
    input_vector[HYDRAULIC_FORCE_RATE] += scale * (slope_a / volume_a * rate_a + ratio * slope_b / volume_b * rate_b)
