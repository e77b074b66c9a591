# SPDX-License-Identifier: Apache-2.0
"""Layout of the state, and its scales in the certificate.

A metric adds squares of newtons, pascals and metres; it is well conditioned, and its certificate comparable between
benches, only if each state is first divided by what it typically is::

    f_h     f_h'    f_l     f_l'    p_a          p_b          x_p          x_p'
    300 N   3770    300 N   3770    300 N/A_p    300 N/A_p    300 N/k_s    3770 N/s/k_s
            N/s             N/s     1.5 MPa      1.5 MPa      15 mm        0.19 m/s

300 N and 2 pi 2 Hz 300 N are the paper's largest reference and its rate; the others follow from the bench.
"""

from __future__ import annotations

from math import pi

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_sim.model.bench import Bench

STATES = 8
"""Length of x (paper eq. state_def)."""

(
    HYDRAULIC_FORCE,
    HYDRAULIC_FORCE_RATE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    PRESSURE_A,
    PRESSURE_B,
    POSITION,
    VELOCITY,
) = range(STATES)
"""Indices into x."""

FORCE_SCALE = 300.0
"""N, the paper's largest reference amplitude."""

FORCE_RATE_SCALE = FORCE_SCALE * 2.0 * pi * 2.0
"""N/s, the largest rate of a 300 N sine at 2 Hz."""


def state_scale(bench: Bench) -> FloatArray:
    """Scales of the eight states, shape (8,), in the states' units."""
    pressure = FORCE_SCALE / bench.piston_area
    position, velocity = FORCE_SCALE / bench.spring_stiffness, FORCE_RATE_SCALE / bench.spring_stiffness
    forces = [FORCE_SCALE, FORCE_RATE_SCALE, FORCE_SCALE, FORCE_RATE_SCALE]
    return np.array([*forces, pressure, pressure, position, velocity])
