# SPDX-License-Identifier: Apache-2.0
"""Oil in a chamber, by content instead of pressure.

A chamber's state is its *content* W [m3]: the volume that its oil, free air included, would fill at zero gauge
pressure. Mass is conserved exactly, and pressure follows from how far the content is squeezed::

    V + c p = W v(p)        v(p) = (1 - phi) exp(-p / beta) + phi (p_0 / (p_0 + p))^(1/n)

with the chamber's volume V, the hoses' compliance c, the air fraction phi at atmospheric pressure p_0 and the exponent
n. A flow q [m3/s] at the chamber's pressure changes the content by q / v(p). For phi = c = 0 this is
p' = beta / V (q - V').
"""

from __future__ import annotations

import math

from hydro_sim.emulator.truth.parameters import ATMOSPHERE
from hydro_sim.jit import njit

VAPOR_PRESSURE = -0.95 * ATMOSPHERE  # Pa, gauge: below it a cavity opens instead


@njit
def specific_volume(p, pressure):
    """Volume per content v(p), and its slope dv/dp [1/Pa]."""
    oil = (1.0 - p.air_fraction) * math.exp(-pressure / p.bulk_modulus)
    if p.air_fraction == 0.0:
        return oil, -oil / p.bulk_modulus
    air = p.air_fraction * (ATMOSPHERE / (ATMOSPHERE + pressure)) ** (1.0 / p.air_exponent)
    return oil + air, -oil / p.bulk_modulus - air / (p.air_exponent * (ATMOSPHERE + pressure))


@njit
def pressure_of(p, content, volume, guess):
    """Pressure [Pa] of `content` [m3] in `volume` [m3]; `guess` [Pa] is where Newton's iteration begins."""
    if p.air_fraction == 0.0 and p.wall_compliance == 0.0:
        return max(p.bulk_modulus * math.log(content / volume), VAPOR_PRESSURE)
    pressure = guess
    for _ in range(30):
        v, slope = specific_volume(p, pressure)
        change = (volume + p.wall_compliance * pressure - content * v) / (p.wall_compliance - content * slope)
        # v is convex and steep near the vapor pressure: never go more than half of the way there in one iteration
        pressure = max(pressure - change, 0.5 * (pressure + VAPOR_PRESSURE))
        if abs(change) < 1e-3:
            break
    return max(pressure, VAPOR_PRESSURE)


@njit
def content_of(p, pressure, volume):
    """Content [m3] that gives `pressure` [Pa] in `volume` [m3]."""
    v, _ = specific_volume(p, pressure)
    return (volume + p.wall_compliance * pressure) / v
