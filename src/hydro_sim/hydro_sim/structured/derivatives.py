# SPDX-License-Identifier: Apache-2.0
"""Derivatives of `structured.physics`, written by `python -m hydro_sim.structured.generate`: edit that, not this.

Where a slope jumps (a valve's edge at zero opening, a velocity of zero) the derivative is that of the side the model is
on. End stops have none: training never reaches them.
"""

from __future__ import annotations

import math

from hydro_sim.jit import njit
from hydro_sim.structured.physics import (
    AREA,
    BRISTLE,
    BRISTLE_DAMPING,
    BULK,
    CELL_DAMPING,
    CELL_OMEGA,
    COULOMB,
    DAMPING_VELOCITY,
    DEAD_A,
    DEAD_B,
    KA_NEGATIVE,
    KA_POSITIVE,
    KB_NEGATIVE,
    KB_POSITIVE,
    LEAK,
    MASS,
    OFFSET,
    RATIO,
    REST,
    SPOOL_DAMPING,
    SPOOL_OMEGA,
    SPRING,
    STRIBECK,
    STRIBECK_VELOCITY,
    STROKE,
    SUPPLY,
    TANK,
    VISCOUS,
)


@njit
def partials(c, y, current, r, slope, p):
    """y' and, in rows 0, 1, 3, 5, 7 of p, d(y')/d(y, z, r): both without dry friction."""
    a0 = 1.0 / (c[DEAD_A] + c[AREA] * y[2])
    a1 = c[BULK] * a0
    a2 = y[4] + c[OFFSET]
    a3 = a2 >= 0.0
    a4 = c[KA_POSITIVE] if a3 else c[KA_NEGATIVE]
    a5 = c[SUPPLY] - y[0] if a3 else y[0] - c[TANK]
    a6 = math.sqrt(a5**2 + 100000000.0)
    a7 = 1.0 / math.sqrt(a6)
    a8 = a5 * a7
    a9 = a4 * a8
    a10 = a9 * a2
    a11 = 1.0 + r[0]
    a12 = c[LEAK] * (y[0] - y[1])
    a13 = c[AREA] * y[3]
    a14 = a10 * a11 - a12 - a13
    slope[0] = a1 * a14
    a15 = c[RATIO] * c[AREA]
    a16 = 1.0 / (c[DEAD_B] + a15 * (c[STROKE] - y[2]))
    a17 = c[BULK] * a16
    a18 = c[KB_POSITIVE] if a3 else c[KB_NEGATIVE]
    a19 = y[1] - c[TANK] if a3 else c[SUPPLY] - y[1]
    a20 = math.sqrt(a19**2 + 100000000.0)
    a21 = 1.0 / math.sqrt(a20)
    a22 = a19 * a21
    a23 = a18 * a22
    a24 = a23 * a2
    a25 = 1.0 + r[1]
    a26 = a12 - a24 * a25 + c[RATIO] * a13
    slope[1] = a17 * a26
    slope[2] = y[3]
    a27 = c[SPRING] * (y[2] - c[REST])
    a28 = 1.0 / c[MASS]
    slope[3] = (c[AREA] * (y[0] - c[RATIO] * y[1]) - c[VISCOUS] * y[3] - a27 + r[2]) * a28
    slope[4] = y[5]
    a29 = 2.0 * c[SPOOL_DAMPING]
    slope[5] = c[SPOOL_OMEGA] * (c[SPOOL_OMEGA] * (current - y[4]) - a29 * y[5])
    slope[6] = y[7]
    a30 = 2.0 * c[CELL_DAMPING]
    slope[7] = c[CELL_OMEGA] * (c[CELL_OMEGA] * (a27 - y[6]) - a30 * y[7])
    a31 = -1.0 if a3 else 1.0
    p[0, 0] = a1 * (a11 * (a2 * (a4 * (a31 * a7 - a8 * a7 * (2.0 * a5 * a31 * 0.5 / a6 * 0.5 * a7)))) - c[LEAK])
    p[1, 0] = a17 * c[LEAK]
    p[3, 0] = c[AREA] * a28
    p[0, 1] = a1 * c[LEAK]
    a32 = 1.0 if a3 else -1.0
    p[1, 1] = -(
        a17 * (c[LEAK] + a25 * (a2 * (a18 * (a32 * a21 - a22 * a21 * (2.0 * a19 * a32 * 0.5 / a20 * 0.5 * a21)))))
    )
    p[3, 1] = -(c[AREA] * c[RATIO] * a28)
    p[0, 2] = -(a14 * (a1 * a0 * c[AREA]))
    p[1, 2] = a26 * (a17 * a16 * a15)
    p[3, 2] = -(c[SPRING] * a28)
    p[7, 2] = c[CELL_OMEGA] * (c[CELL_OMEGA] * c[SPRING])
    p[0, 3] = -(a1 * c[AREA])
    p[1, 3] = a17 * a15
    p[3, 3] = -(c[VISCOUS] * a28)
    p[0, 4] = a1 * (a11 * a9)
    p[1, 4] = -(a17 * (a25 * a23))
    p[5, 4] = -(c[SPOOL_OMEGA] ** 2)
    p[5, 5] = -(c[SPOOL_OMEGA] * a29)
    p[7, 6] = -(c[CELL_OMEGA] ** 2)
    p[7, 7] = -(c[CELL_OMEGA] * a30)
    p[0, 9] = a1 * a10
    p[1, 10] = -(a17 * a24)
    p[3, 11] = a28


@njit
def friction_partials(c, velocity, z):
    """Dry friction [N]; its slopes by velocity, bristle."""
    a0 = 1.0 / c[DAMPING_VELOCITY]
    a1 = velocity * a0
    a2 = math.exp(-(a1**2))
    a3 = c[BRISTLE_DAMPING] * a2
    a4 = velocity >= 0.0
    a5 = 1.0 / c[STRIBECK_VELOCITY]
    a6 = velocity * a5
    a7 = math.exp(-(a6**2))
    a8 = 1.0 / (c[COULOMB] + c[STRIBECK] * a7)
    a9 = c[BRISTLE] * (velocity if a4 else -velocity) * a8
    a10 = velocity - a9 * z
    dry = c[BRISTLE] * z + a3 * a10
    by_velocity = a3 * (
        1.0 - z * (c[BRISTLE] * (1.0 if a4 else -1.0) * a8 + a9 * a8 * (c[STRIBECK] * (a7 * (2.0 * a6 * a5))))
    ) - a10 * (c[BRISTLE_DAMPING] * (a2 * (2.0 * a1 * a0)))
    by_bristle = c[BRISTLE] - a3 * a9
    return dry, by_velocity, by_bristle
