# SPDX-License-Identifier: Apache-2.0
"""Coordinates of the force loop in the certificate, their scales, and the law's feedback in them.

The paper's x holds states that the force loop does not move (the sum of the pressures) and lacks states that make high
gains unstable (the spool, the velocity as the box differentiates it). The loop's own coordinates are::

    q = [ f_h    g spool   g spool'   f_l    f_l'   x_p   x_p'   x_p' as the box has it ]        8, `LOOP_FIELDS`
          N      N/s       N/s^2      N      N/s    m     m/s    m/s

and those that a bench file adds (`terms`). f_l and f_l' are what the load cell shows, behind its amplifier.
The spool counts by the force rate g(x) that it drives: the law divides by g, and so the loop is nearly the same
everywhere. One sample of 1 ms, in units of the scales::

    q_{k+1} = F q_k + G u_k        F, G: exact, of the bench file's model; a change of f_h is spread over the pressures
    u_k     = K q_k                as the chambers' stiffnesses do         K: exact, of the force law that the box runs

Dry friction is a bounded disturbance, no part of the loop, and is left out of F (safety.md). K is taken on the
side of zero on which the spool stands, as F is: the two part for the few milliseconds in which the spool follows a
current through zero.

K = du/dx follows from the force law (paper eq. fl_rl) in closed form::

    u = (f_c' + K_p (f_c - f_l) + I - C_1 h) / (C_2 g)        g = g(x_p, p_a, p_b), h = h(x_p, x_p')

    du/df_l  = -K_p / (C_2 g)            du/dx_p  = -(C_1 dh/dx_p + C_2 u dg/dx_p) / (C_2 g)
    du/dx_p' = -C_1 (dh/dx_p') / (C_2 g) du/dp_a  = -u (dg/dp_a) / g,  the same for p_b

The paper's law has f_c = f_r and C_1 = C_2 = 1. K does not depend on f_c: a reference that is shaped leaves the loop
alone. With F(x, u) = h + g u the right side of eq. q13, and h linear in the velocity, C_1 h + C_2 g u is F at C_1 x_p'
and C_2 u: K is its slope at held u over -C_2 g, except along f_l. F's slopes by the pressures go by way of the roots of
the pressure drops (paper eq. q13-q15 with physics.md's erratum). As in `firmware/hydro/force_law.h`, C_2 g is no less
than a floor (there dg/dx = 0) and the position is one within the stroke. The integral I, of either form, is the law's
own memory and no function of x: K_i has no place in K, and the certificate does not see it.

K is that of the law before the valve's limit. Beyond the limit the valve passes none of it on: the remaining authority
of the correction is in the QP's bounds (`loop_decision`), not in K.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_core.signals import FloatArray
from hydro_filter.model.sample import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, VELOCITY
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.model.hydraulics import input_gain

LOOP_FIELDS = ("f_h", "spool", "spool_rate", "f_l", "f_l_rate", "x_p", "x_p_rate", "x_p_rate_box")
LOOP = len(LOOP_FIELDS)
Q_HYDRAULIC, Q_SPOOL, Q_SPOOL_RATE, Q_LOAD, Q_LOAD_RATE, Q_POSITION, Q_VELOCITY, Q_BOX_VELOCITY = range(LOOP)

INPUT = Q_BOX_VELOCITY
"""Column of tangents that is the current's: the box's memory of the velocity moves nothing, and needs none."""

LOOP_RATE = 130.0
"""rad/s, unit of force rates and speeds on every bench: the tables of metric files are in it."""


def loop_scale(bench: Bench) -> FloatArray:
    """Scales of the coordinates, shape (8,): the bench's force, at `LOOP_RATE`, and the drive that this takes."""
    force = bench.size.force
    position, rate = force / bench.spring_stiffness, force * LOOP_RATE
    speed, drive = position * LOOP_RATE, 20.0 * rate  # the oil is some 18 times as stiff as the spring
    return np.array([force, drive, 500.0 * drive, force, rate, position, speed, speed])


def least_gain(area: float, stiffness_a: float, valve_gain: float, supply: float) -> float:
    """Smallest g [N/s/A] of a linearization: a chamber at its limit has none."""
    return 0.1 * area * stiffness_a * valve_gain * math.sqrt(0.5 * supply)


PAPER_SCALES = (1.0, 1.0)
"""C_1 and C_2 of the paper's law."""

SMALLEST_DROP = 1e3
"""Pa; the slope of a square root is taken no nearer to zero pressure drop than this: it is infinite there."""


@njit
def gradient(constants, state, current, proportional_gain, gain_floor, out, scales=PAPER_SCALES):
    """Write K, shape (8,), for the law's own current [A], K_p [1/s] and (C_1, C_2); `constants` of shape (1,)."""
    bench, (c_1, c_2) = constants[0], scales
    gain = c_2 * input_gain(bench, state[POSITION], state[PRESSURE_A], state[PRESSURE_B], current)
    felt = c_2 * current if gain > gain_floor else 0.0  # at the floor the law does not depend on changes of g
    gain = max(gain, gain_floor)
    out[:] = state
    out[VELOCITY] *= c_1
    by_position, by_velocity, by_a, by_b = force_rate_slopes(bench, out, felt)
    out[:] = 0.0
    out[LOAD_FORCE] = -proportional_gain / gain
    out[PRESSURE_A] = -by_a / gain
    out[PRESSURE_B] = -by_b / gain
    out[POSITION] = -by_position / gain if 0.0 <= state[POSITION] <= bench.stroke else 0.0
    out[VELOCITY] = -c_1 * by_velocity / gain


@njit
def force_rate_slopes(bench, state, current):
    """Slopes of F(x, u), f_h' of eq. q13, at held u: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b."""
    root_a, root_b, slope_a, slope_b = root_slopes(bench, state[PRESSURE_A], state[PRESSURE_B], current)
    area, ratio = bench.piston_area, bench.area_ratio
    area_b, displaced = ratio * area, area * state[VELOCITY]
    per_volume_a = 1.0 / (bench.dead_volume_a + area * state[POSITION])
    per_volume_b = 1.0 / (bench.dead_volume_b + area_b * (bench.stroke - state[POSITION]))
    stiffness_a, stiffness_b = bench.bulk_modulus * per_volume_a, bench.bulk_modulus * per_volume_b
    into_a = bench.valve_gain * root_a * current - displaced
    into_b = ratio * displaced - bench.valve_gain * root_b * current
    by_position = -(
        area * (into_a * (stiffness_a * per_volume_a * area) + ratio * (into_b * (stiffness_b * per_volume_b * area_b)))
    )
    by_velocity = -(area * (stiffness_a * area + ratio * (stiffness_b * area_b)))
    opening = current * bench.valve_gain
    by_a = area * (stiffness_a * opening) * slope_a
    by_b = area * (ratio * (stiffness_b * opening)) * slope_b
    return by_position, by_velocity, by_a, by_b


@njit
def root_slopes(bench, pressure_a, pressure_b, opening):
    """Roots of the pressure drops at A and at B under an opening, and their slopes by the pressures."""
    out, back = eq.edge_drops(bench.supply_pressure, bench.tank_pressure, pressure_a, pressure_b)
    (drop_a, drop_b), sign = (out, 1.0) if opening >= 0.0 else (back, -1.0)
    root_a, root_b = eq.signed_root(drop_a), eq.signed_root(drop_b)
    size_a, size_b = np.sqrt(max(abs(drop_a), SMALLEST_DROP)), np.sqrt(max(abs(drop_b), SMALLEST_DROP))
    return root_a, root_b, -0.5 * sign / size_a, 0.5 * sign / size_b


@njit
def law_feedback(loop, x, nominal_current, proportional_gain, scales, share_a, share_b, step):
    """Feedback K [A] of the force law into `step`; a change of f_h is `share_a`, `share_b` of the pressures [Pa/N]."""
    law, feedback, scale = step.law, step.feedback, loop.scale
    gradient(loop.bench, x, nominal_current, proportional_gain, loop.gain_floor, law, scales)
    feedback[:] = 0.0
    feedback[Q_HYDRAULIC] = (law[PRESSURE_A] * share_a + law[PRESSURE_B] * share_b) * scale[Q_HYDRAULIC]
    feedback[Q_LOAD] = law[LOAD_FORCE] * scale[Q_LOAD]
    feedback[Q_POSITION] = law[POSITION] * scale[Q_POSITION]
    feedback[Q_BOX_VELOCITY] = law[VELOCITY] * scale[Q_BOX_VELOCITY]
