# SPDX-License-Identifier: Apache-2.0
"""Coordinates of the force loop in the certificate, their scales, and the law's feedback in them.

The paper's x holds states that the force loop does not move (the sum of the pressures) and lacks states that make high
gains unstable (the spool, the velocity as the box differentiates it). The loop's own coordinates are::

    q = [ f_h    g spool   g spool'   f_l    f_l'   x_p   x_p'   x_p' as the box has it ]        8, `LOOP_FIELDS`
          N      N/s       N/s^2      N      N/s    m     m/s    m/s

and those that a bench file adds (`added_coordinates`). f_l and f_l' are what the load cell shows, behind its amplifier.
The spool counts by the force rate g(x) that it drives: the law divides by g, and so the loop is nearly the same
everywhere. One sample of 1 ms, in units of the scales::

    q_{k+1} = F q_k + G u_k        F, G: exact, of the bench file's model; a change of f_h is spread over the pressures
    u_k     = K q_k                as the chambers' stiffnesses do         K: exact, of the force law that the box runs

Dry friction is a bounded disturbance, no part of the loop, and is left out of F (safety.md). K is taken on the
side of zero on which the spool stands, as F is: the two part for the few milliseconds in which the spool follows a
current through zero.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_filter.model import force_law
from hydro_filter.model.state import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, VELOCITY
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench

LOOP_FIELDS = ("f_h", "spool", "spool_rate", "f_l", "f_l_rate", "x_p", "x_p_rate", "x_p_rate_box")
LOOP = len(LOOP_FIELDS)
Q_HYDRAULIC, Q_SPOOL, Q_SPOOL_RATE, Q_LOAD, Q_LOAD_RATE, Q_POSITION, Q_VELOCITY, Q_BOX_VELOCITY = range(LOOP)

INPUT = Q_BOX_VELOCITY
"""Column of tangents that is the current's: the box's memory of the velocity moves nothing, and needs none."""

LOOP_RATE = 130.0
"""rad/s: sqrt(k_s / m) of the nominal bench; force rates and speeds are scaled with it."""


def loop_scale(bench: Bench) -> FloatArray:
    """Scales of the coordinates, shape (8,): the bench's force, at `LOOP_RATE`, and the drive that this takes."""
    force = bench.size.force
    position, rate = force / bench.spring_stiffness, force * LOOP_RATE
    speed, drive = position * LOOP_RATE, 20.0 * rate  # the oil is some 18 times as stiff as the spring
    return np.array([force, drive, 500.0 * drive, force, rate, position, speed, speed])


def least_gain(area: float, stiffness_a: float, valve_gain: float, supply: float) -> float:
    """Smallest g [N/s/A] of a linearization: a chamber at its limit has none."""
    return 0.1 * area * stiffness_a * valve_gain * math.sqrt(0.5 * supply)


@njit
def law_feedback(loop, x, nominal_current, proportional_gain, scales, share_a, share_b, step):
    """Feedback K [A] of the force law into `step`; a change of f_h is `share_a`, `share_b` of the pressures [Pa/N]."""
    law, feedback, scale = step.law, step.feedback, loop.scale
    force_law.gradient(loop.bench, x, nominal_current, proportional_gain, loop.gain_floor, law, scales)
    feedback[:] = 0.0
    feedback[Q_HYDRAULIC] = (law[PRESSURE_A] * share_a + law[PRESSURE_B] * share_b) * scale[Q_HYDRAULIC]
    feedback[Q_LOAD] = law[LOAD_FORCE] * scale[Q_LOAD]
    feedback[Q_POSITION] = law[POSITION] * scale[Q_POSITION]
    feedback[Q_BOX_VELOCITY] = law[VELOCITY] * scale[Q_BOX_VELOCITY]
