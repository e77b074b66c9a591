# SPDX-License-Identifier: Apache-2.0
"""Coordinates of the force loop in the certificate, and their scales.

The paper's x holds states that the force loop does not move (the sum of the pressures) and lacks states that make high
gains unstable (the spool, the velocity as the box differentiates it). The loop's own coordinates are::

    q = [ f_h    g spool   g spool'   f_l    f_l'   x_p   x_p'   x_p' as the box has it ]        8, `LOOP_FIELDS`
          N      N/s       N/s^2      N      N/s    m     m/s    m/s

and those that a bench file adds (`terms`). f_l and f_l' are the load cell's output, behind its amplifier, and its rate.
The spool is in units of the force rate g(x) that it drives: the law divides by g, and so the loop is nearly the same
everywhere. One sample of 1 ms, in units of the scales::

    q_{k+1} = F q_k + G u_k        F, G: exact, of the bench file's model; a change of f_h is spread over the pressures
    u_k     = K q_k                as the chambers' stiffnesses do         K: exact, of the force law that the box runs

Dry friction is a bounded disturbance, no part of the loop, and is left out of F (filter.md). F and K are taken on the
spool's side of zero. The law's own side differs for the few milliseconds in which the spool follows a current through
zero.

The paper's law has f_c = f_r and C_1 = C_2 = 1. K does not depend on f_c: shaping the reference does not change the
loop. The integral I, of either form, is a state of the law and no function of x: K_i has no place in K, and the
certificate does not see it. K is that of the law before saturation. A saturated valve passes none of it on: the
remaining authority of the correction is in the QP's bounds, not in K. All of F, G, K and the displacement is
computed by `firmware/hydro/loop.h`.
"""

from __future__ import annotations

import numpy as np

from hydro_core.signals import FloatArray
from hydro_sim.model.bench import Bench

LOOP_FIELDS = ("f_h", "spool", "spool_rate", "f_l", "f_l_rate", "x_p", "x_p_rate", "x_p_rate_box")
LOOP_SIZE = len(LOOP_FIELDS)
Q_HYDRAULIC, Q_SPOOL, Q_SPOOL_RATE, Q_LOAD, Q_LOAD_RATE, Q_POSITION, Q_VELOCITY, Q_BOX_VELOCITY = range(LOOP_SIZE)

SCALING_RATE = 130.0
"""rad/s, frequency that relates the scales of rates and speeds to those of forces and positions, on every bench."""


def coordinate_scales(bench: Bench) -> FloatArray:
    """Return the scales of the loop coordinates, shape (8,), from the bench's force and `SCALING_RATE`."""
    force = bench.size.force
    position, rate = force / bench.spring_stiffness, force * SCALING_RATE
    speed, drive = position * SCALING_RATE, 20.0 * rate  # the oil is some 18 times as stiff as the spring
    return np.array([force, drive, 500.0 * drive, force, rate, position, speed, speed])
