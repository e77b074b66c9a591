# SPDX-License-Identifier: Apache-2.0
"""Derivatives of `structured.physics`, written by `python -m hydro_sim.structured.generate`: edit that, not this.

Where a slope jumps (a valve's edge at zero opening, a velocity of zero) the derivative is that of the side the model is
on. End stops have none: training never reaches them.
"""

from __future__ import annotations

import math

from numba import njit

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


@njit(cache=True)
def partials(c, y, current, r, slope, p):
    """y' and, in rows 0, 1, 3, 5, 7 of p, d(y')/d(y, z, r): both without dry friction."""
    a0 = c[DEAD_A] + c[AREA] * y[2]
    a1 = c[BULK] / a0
    a2 = y[4] + c[OFFSET]
    a3 = a2 >= 0.0
    a4 = c[KA_POSITIVE] if a3 else c[KA_NEGATIVE]
    a5 = c[SUPPLY] - y[0] if a3 else y[0] - c[TANK]
    a6 = math.sqrt(a5**2 + 100000000.0)
    a7 = math.sqrt(a6)
    a8 = a5 / a7
    a9 = a4 * a8
    a10 = a9 * a2
    a11 = 1.0 + r[0]
    a12 = c[LEAK] * (y[0] - y[1])
    a13 = c[AREA] * y[3]
    a14 = a10 * a11 - a12 - a13
    slope[0] = a1 * a14
    a15 = c[RATIO] * c[AREA]
    a16 = c[DEAD_B] + a15 * (c[STROKE] - y[2])
    a17 = c[BULK] / a16
    a18 = c[KB_POSITIVE] if a3 else c[KB_NEGATIVE]
    a19 = y[1] - c[TANK] if a3 else c[SUPPLY] - y[1]
    a20 = math.sqrt(a19**2 + 100000000.0)
    a21 = math.sqrt(a20)
    a22 = a19 / a21
    a23 = a18 * a22
    a24 = a23 * a2
    a25 = 1.0 + r[1]
    a26 = a12 - a24 * a25 + c[RATIO] * a13
    slope[1] = a17 * a26
    slope[2] = y[3]
    a27 = c[SPRING] * (y[2] - c[REST])
    slope[3] = (c[AREA] * (y[0] - c[RATIO] * y[1]) - c[VISCOUS] * y[3] - a27 + r[2]) / c[MASS]
    slope[4] = y[5]
    a28 = 2.0 * c[SPOOL_DAMPING]
    slope[5] = c[SPOOL_OMEGA] * (c[SPOOL_OMEGA] * (current - y[4]) - a28 * y[5])
    slope[6] = y[7]
    a29 = 2.0 * c[CELL_DAMPING]
    slope[7] = c[CELL_OMEGA] * (c[CELL_OMEGA] * (a27 - y[6]) - a29 * y[7])
    a30 = -1.0 if a3 else 1.0
    p[0, 0] = a1 * (a11 * (a2 * (a4 * (a30 / a7 - a8 / a7 * (2.0 * a5 * a30 / (2.0 * a6) / (2.0 * a7))))) - c[LEAK])
    p[1, 0] = a17 * c[LEAK]
    p[3, 0] = c[AREA] / c[MASS]
    p[0, 1] = a1 * c[LEAK]
    a31 = 1.0 if a3 else -1.0
    p[1, 1] = -(
        a17 * (c[LEAK] + a25 * (a2 * (a18 * (a31 / a21 - a22 / a21 * (2.0 * a19 * a31 / (2.0 * a20) / (2.0 * a21))))))
    )
    p[3, 1] = -(c[AREA] * c[RATIO] / c[MASS])
    p[0, 2] = -(a14 * (a1 / a0 * c[AREA]))
    p[1, 2] = a26 * (a17 / a16 * a15)
    p[3, 2] = -(c[SPRING] / c[MASS])
    p[7, 2] = c[CELL_OMEGA] * (c[CELL_OMEGA] * c[SPRING])
    p[0, 3] = -(a1 * c[AREA])
    p[1, 3] = a17 * a15
    p[3, 3] = -(c[VISCOUS] / c[MASS])
    p[0, 4] = a1 * (a11 * a9)
    p[1, 4] = -(a17 * (a25 * a23))
    p[5, 4] = -(c[SPOOL_OMEGA] ** 2)
    p[5, 5] = -(c[SPOOL_OMEGA] * a28)
    p[7, 6] = -(c[CELL_OMEGA] ** 2)
    p[7, 7] = -(c[CELL_OMEGA] * a29)
    p[0, 9] = a1 * a10
    p[1, 10] = -(a17 * a24)
    p[3, 11] = 1.0 / c[MASS]


@njit(cache=True)
def friction_partials(c, velocity, z):
    """Dry friction [N]; its slopes by velocity, bristle."""
    a0 = velocity / c[DAMPING_VELOCITY]
    a1 = math.exp(-(a0**2))
    a2 = c[BRISTLE_DAMPING] * a1
    a3 = velocity >= 0.0
    a4 = velocity / c[STRIBECK_VELOCITY]
    a5 = math.exp(-(a4**2))
    a6 = c[COULOMB] + c[STRIBECK] * a5
    a7 = c[BRISTLE] * (velocity if a3 else -velocity) / a6
    a8 = velocity - a7 * z
    dry = c[BRISTLE] * z + a2 * a8
    by_velocity = a2 * (
        1.0
        - z
        * (c[BRISTLE] * (1.0 if a3 else -1.0) / a6 + a7 / a6 * (c[STRIBECK] * (a5 * (2.0 * a4 / c[STRIBECK_VELOCITY]))))
    ) - a8 * (c[BRISTLE_DAMPING] * (a1 * (2.0 * a0 / c[DAMPING_VELOCITY])))
    by_bristle = c[BRISTLE] - a2 * a7
    return dry, by_velocity, by_bristle


@njit(cache=True)
def rates_back(c, y, z, current, r, g, gy, gr, gc):
    """Add to gy, gr, gc the gradients of g . y' by y, r, c; returns that by z."""
    a0 = y[0] - y[1]
    a1 = c[LEAK] * a0
    a2 = y[4] + c[OFFSET]
    a3 = a2 >= 0.0
    a4 = c[KB_POSITIVE] if a3 else c[KB_NEGATIVE]
    a5 = y[1] - c[TANK] if a3 else c[SUPPLY] - y[1]
    a6 = math.sqrt(a5**2 + 100000000.0)
    a7 = math.sqrt(a6)
    a8 = a5 / a7
    a9 = a4 * a8
    a10 = a9 * a2
    a11 = 1.0 + r[1]
    a12 = c[AREA] * y[3]
    a13 = (a1 - a10 * a11 + c[RATIO] * a12) * g[1]
    a14 = c[RATIO] * c[AREA]
    a15 = c[STROKE] - y[2]
    a16 = c[DEAD_B] + a14 * a15
    a17 = c[KA_POSITIVE] if a3 else c[KA_NEGATIVE]
    a18 = c[SUPPLY] - y[0] if a3 else y[0] - c[TANK]
    a19 = math.sqrt(a18**2 + 100000000.0)
    a20 = math.sqrt(a19)
    a21 = a18 / a20
    a22 = a17 * a21
    a23 = a22 * a2
    a24 = 1.0 + r[0]
    a25 = (a23 * a24 - a1 - a12) * g[0]
    a26 = c[DEAD_A] + c[AREA] * y[2]
    gc[BULK] += a13 / a16 + a25 / a26
    a27 = y[0] - c[RATIO] * y[1]
    a28 = g[3] / c[MASS]
    a29 = c[BULK] / a16
    a30 = a29 / a16 * a13
    a31 = a15 * a30
    a32 = a29 * g[1]
    a33 = c[BULK] / a26
    a34 = a33 * g[0]
    a35 = c[RATIO] * a32 - a34
    a36 = a33 / a26 * a25
    gc[AREA] += a27 * a28 - c[RATIO] * a31 + y[3] * a35 - y[2] * a36
    a37 = c[AREA] * a28
    gc[RATIO] += a12 * a32 - y[1] * a37 - c[AREA] * a31
    gc[DEAD_A] -= a36
    gc[DEAD_B] -= a30
    a38 = a11 * a32
    a39 = a2 * a38
    a40 = a4 * a39
    a41 = 2.0 * a5 * (a8 / a7 * a40 / (2.0 * a7) / (2.0 * a6)) - a40 / a7
    a42 = not a3
    a43 = a24 * a34
    a44 = a2 * a43
    a45 = a17 * a44
    a46 = a45 / a20 - 2.0 * a18 * (a21 / a20 * a45 / (2.0 * a20) / (2.0 * a19))
    gc[SUPPLY] += (a41 if a42 else 0.0) + (a46 if a3 else 0.0)
    a47 = -a41
    a48 = -a46
    gc[TANK] += a47 if a3 else a48
    a49 = a21 * a44
    gc[KA_POSITIVE] += a49 if a3 else 0.0
    gc[KA_NEGATIVE] += a49 if a42 else 0.0
    a50 = -(a8 * a39)
    gc[KB_POSITIVE] += a50 if a3 else 0.0
    gc[KB_NEGATIVE] += a50 if a42 else 0.0
    a51 = a22 * a43 - a9 * a38
    gc[OFFSET] += a51
    a52 = a32 - a34
    gc[LEAK] += a0 * a52
    a53 = y[2] - c[REST]
    a54 = c[SPRING] * a53
    a55 = y[3] / c[DAMPING_VELOCITY]
    a56 = math.exp(-(a55**2))
    a57 = c[BRISTLE_DAMPING] * a56
    a58 = y[3] >= 0.0
    a59 = y[3] if a58 else -y[3]
    a60 = y[3] / c[STRIBECK_VELOCITY]
    a61 = math.exp(-(a60**2))
    a62 = c[COULOMB] + c[STRIBECK] * a61
    a63 = c[BRISTLE] * a59 / a62
    a64 = y[3] - a63 * z
    gc[MASS] -= (
        (c[AREA] * a27 - c[VISCOUS] * y[3] - a54 + r[2] - (c[BRISTLE] * z + a57 * a64)) / c[MASS] / c[MASS] * g[3]
    )
    gc[VISCOUS] -= y[3] * a28
    a65 = c[CELL_OMEGA] * g[7]
    a66 = c[CELL_OMEGA] * a65
    a67 = a66 - a28
    gc[SPRING] += a53 * a67
    a68 = c[SPRING] * a67
    gc[REST] -= a68
    a69 = current - y[4]
    a70 = 2.0 * c[SPOOL_DAMPING]
    a71 = c[SPOOL_OMEGA] * g[5]
    gc[SPOOL_OMEGA] += (c[SPOOL_OMEGA] * a69 - a70 * y[5]) * g[5] + a69 * a71
    gc[SPOOL_DAMPING] += 2.0 * -(y[5] * a71)
    a72 = a54 - y[6]
    a73 = 2.0 * c[CELL_DAMPING]
    gc[CELL_OMEGA] += (c[CELL_OMEGA] * a72 - a73 * y[7]) * g[7] + a72 * a65
    gc[CELL_DAMPING] += 2.0 * -(y[7] * a65)
    a74 = a57 * a28
    a75 = z * a74
    a76 = a63 / a62 * a75
    gc[COULOMB] -= a76
    gc[STRIBECK] -= a61 * a76
    a77 = 2.0 * a60 * (a61 * (c[STRIBECK] * a76))
    gc[STRIBECK_VELOCITY] -= a60 / c[STRIBECK_VELOCITY] * a77
    a78 = a75 / a62
    gc[BRISTLE] += a59 * a78 - z * a28
    a79 = a64 * a28
    gc[BRISTLE_DAMPING] -= a56 * a79
    a80 = 2.0 * a55 * (a56 * (c[BRISTLE_DAMPING] * a79))
    gc[DAMPING_VELOCITY] -= a55 / c[DAMPING_VELOCITY] * a80
    a81 = c[LEAK] * a52
    gy[0] += a37 + a81 + (a46 if a42 else 0.0) + (a48 if a3 else 0.0)
    gy[1] += (a47 if a42 else 0.0) - c[RATIO] * a37 + (a41 if a3 else 0.0) - a81
    gy[2] += a68 + a14 * a30 - c[AREA] * a36
    a82 = c[BRISTLE] * a78
    gy[3] += (
        a77 / c[STRIBECK_VELOCITY]
        - a74
        + (-a82 if not a58 else 0.0)
        + (a82 if a58 else 0.0)
        + a80 / c[DAMPING_VELOCITY]
        - c[VISCOUS] * a28
        + g[2]
        + c[AREA] * a35
    )
    gy[4] += a51 - c[SPOOL_OMEGA] * a71
    gy[5] += g[4] - a70 * a71
    gy[6] -= a66
    gy[7] += g[6] - a73 * a65
    gr[0] += a23 * a34
    gr[1] -= a10 * a32
    gr[2] += a28
    return a63 * a74 - c[BRISTLE] * a28
