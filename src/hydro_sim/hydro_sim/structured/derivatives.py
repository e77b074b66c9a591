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


@njit
def rates_back(c, y, z, current, r, g, gy, gr, gc):
    """Add to gy, gr, gc the gradients of g . y' by y, r, c; returns that by z."""
    a0 = y[0] - y[1]
    a1 = c[LEAK] * a0
    a2 = y[4] + c[OFFSET]
    a3 = a2 >= 0.0
    a4 = c[KB_POSITIVE] if a3 else c[KB_NEGATIVE]
    a5 = y[1] - c[TANK] if a3 else c[SUPPLY] - y[1]
    a6 = math.sqrt(a5**2 + 100000000.0)
    a7 = 1.0 / math.sqrt(a6)
    a8 = a5 * a7
    a9 = a4 * a8
    a10 = a9 * a2
    a11 = 1.0 + r[1]
    a12 = c[AREA] * y[3]
    a13 = (a1 - a10 * a11 + c[RATIO] * a12) * g[1]
    a14 = c[RATIO] * c[AREA]
    a15 = c[STROKE] - y[2]
    a16 = 1.0 / (c[DEAD_B] + a14 * a15)
    a17 = c[KA_POSITIVE] if a3 else c[KA_NEGATIVE]
    a18 = c[SUPPLY] - y[0] if a3 else y[0] - c[TANK]
    a19 = math.sqrt(a18**2 + 100000000.0)
    a20 = 1.0 / math.sqrt(a19)
    a21 = a18 * a20
    a22 = a17 * a21
    a23 = a22 * a2
    a24 = 1.0 + r[0]
    a25 = (a23 * a24 - a1 - a12) * g[0]
    a26 = 1.0 / (c[DEAD_A] + c[AREA] * y[2])
    gc[BULK] += a13 * a16 + a25 * a26
    a27 = y[0] - c[RATIO] * y[1]
    a28 = 1.0 / c[MASS]
    a29 = g[3] * a28
    a30 = c[BULK] * a16
    a31 = a30 * a16 * a13
    a32 = a15 * a31
    a33 = a30 * g[1]
    a34 = c[BULK] * a26
    a35 = a34 * g[0]
    a36 = c[RATIO] * a33 - a35
    a37 = a34 * a26 * a25
    gc[AREA] += a27 * a29 - c[RATIO] * a32 + y[3] * a36 - y[2] * a37
    a38 = c[AREA] * a29
    gc[RATIO] += a12 * a33 - y[1] * a38 - c[AREA] * a32
    gc[DEAD_A] -= a37
    gc[DEAD_B] -= a31
    a39 = a11 * a33
    a40 = a2 * a39
    a41 = a4 * a40
    a42 = 2.0 * a5 * (a8 * a7 * a41 * 0.5 * a7 * 0.5 / a6) - a41 * a7
    a43 = not a3
    a44 = a24 * a35
    a45 = a2 * a44
    a46 = a17 * a45
    a47 = a46 * a20 - 2.0 * a18 * (a21 * a20 * a46 * 0.5 * a20 * 0.5 / a19)
    gc[SUPPLY] += (a42 if a43 else 0.0) + (a47 if a3 else 0.0)
    a48 = -a42
    a49 = -a47
    gc[TANK] += a48 if a3 else a49
    a50 = a21 * a45
    gc[KA_POSITIVE] += a50 if a3 else 0.0
    gc[KA_NEGATIVE] += a50 if a43 else 0.0
    a51 = -(a8 * a40)
    gc[KB_POSITIVE] += a51 if a3 else 0.0
    gc[KB_NEGATIVE] += a51 if a43 else 0.0
    a52 = a22 * a44 - a9 * a39
    gc[OFFSET] += a52
    a53 = a33 - a35
    gc[LEAK] += a0 * a53
    a54 = y[2] - c[REST]
    a55 = c[SPRING] * a54
    a56 = 1.0 / c[DAMPING_VELOCITY]
    a57 = y[3] * a56
    a58 = math.exp(-(a57**2))
    a59 = c[BRISTLE_DAMPING] * a58
    a60 = y[3] >= 0.0
    a61 = y[3] if a60 else -y[3]
    a62 = 1.0 / c[STRIBECK_VELOCITY]
    a63 = y[3] * a62
    a64 = math.exp(-(a63**2))
    a65 = 1.0 / (c[COULOMB] + c[STRIBECK] * a64)
    a66 = c[BRISTLE] * a61 * a65
    a67 = y[3] - a66 * z
    gc[MASS] -= (c[AREA] * a27 - c[VISCOUS] * y[3] - a55 + r[2] - (c[BRISTLE] * z + a59 * a67)) * a28 * a28 * g[3]
    gc[VISCOUS] -= y[3] * a29
    a68 = c[CELL_OMEGA] * g[7]
    a69 = c[CELL_OMEGA] * a68
    a70 = a69 - a29
    gc[SPRING] += a54 * a70
    a71 = c[SPRING] * a70
    gc[REST] -= a71
    a72 = current - y[4]
    a73 = 2.0 * c[SPOOL_DAMPING]
    a74 = c[SPOOL_OMEGA] * g[5]
    gc[SPOOL_OMEGA] += (c[SPOOL_OMEGA] * a72 - a73 * y[5]) * g[5] + a72 * a74
    gc[SPOOL_DAMPING] += 2.0 * -(y[5] * a74)
    a75 = a55 - y[6]
    a76 = 2.0 * c[CELL_DAMPING]
    gc[CELL_OMEGA] += (c[CELL_OMEGA] * a75 - a76 * y[7]) * g[7] + a75 * a68
    gc[CELL_DAMPING] += 2.0 * -(y[7] * a68)
    a77 = a59 * a29
    a78 = z * a77
    a79 = a66 * a65 * a78
    gc[COULOMB] -= a79
    gc[STRIBECK] -= a64 * a79
    a80 = 2.0 * a63 * (a64 * (c[STRIBECK] * a79))
    gc[STRIBECK_VELOCITY] -= a63 * a62 * a80
    a81 = a78 * a65
    gc[BRISTLE] += a61 * a81 - z * a29
    a82 = a67 * a29
    gc[BRISTLE_DAMPING] -= a58 * a82
    a83 = 2.0 * a57 * (a58 * (c[BRISTLE_DAMPING] * a82))
    gc[DAMPING_VELOCITY] -= a57 * a56 * a83
    a84 = c[LEAK] * a53
    gy[0] += a38 + a84 + (a47 if a43 else 0.0) + (a49 if a3 else 0.0)
    gy[1] += (a48 if a43 else 0.0) - c[RATIO] * a38 + (a42 if a3 else 0.0) - a84
    gy[2] += a71 + a14 * a31 - c[AREA] * a37
    a85 = c[BRISTLE] * a81
    gy[3] += (
        a80 * a62
        - a77
        + (-a85 if not a60 else 0.0)
        + (a85 if a60 else 0.0)
        + a83 * a56
        - c[VISCOUS] * a29
        + g[2]
        + c[AREA] * a36
    )
    gy[4] += a52 - c[SPOOL_OMEGA] * a74
    gy[5] += g[4] - a73 * a74
    gy[6] -= a69
    gy[7] += g[6] - a76 * a68
    gr[0] += a23 * a35
    gr[1] -= a10 * a33
    gr[2] += a29
    return a66 * a77 - c[BRISTLE] * a29
