# SPDX-License-Identifier: Apache-2.0
"""Supply, leaks and stiffness of the oil. Compiled. Source: Merritt 1967, sections 2-6 and 3-3."""

from __future__ import annotations

import math

from numba import njit

from hydro_sim.model.effects.record import FLOWS, STIFFNESS, SUPPLY

INTERNAL, INTERNAL_ORIFICE, EXTERNAL_A, EXTERNAL_B = range(4)
"""Kinds of FLOWS. Number: coefficient [m3/s/Pa]."""

MODULUS, AIR = range(2)
"""Kinds of STIFFNESS. Numbers: ratio | volume fraction, exponent."""

MEETING_POINT = 5e6
"""Pa, where a leak through a sharp edge passes as much as a laminar one of the same coefficient."""

ATMOSPHERE = 101325.0
"""Pa, at which the free air's volume fraction is stated."""


@njit(cache=True)
def sag(program, demand):
    """Pressure [Pa] that the supply lacks at a lagged `demand` [m3/s]."""
    lacking = 0.0
    for k in range(program.first[SUPPLY], program.first[SUPPLY + 1]):
        lacking += program.value[k, 0] * demand
    return lacking


@njit(cache=True)
def demand_rate(program, drawn, demand):
    """d/dt [m3/s2] of the lagged demand while `drawn` [m3/s] leaves the supply."""
    for k in range(program.first[SUPPLY], program.first[SUPPLY + 1]):
        return (drawn - demand) / program.value[k, 1]
    return 0.0


@njit(cache=True)
def leaks(program, pressure_a, pressure_b, tank):
    """Flow [m3/s] that leaves chamber A and chamber B by other ways than the valve."""
    from_a, from_b = 0.0, 0.0
    for k in range(program.first[FLOWS], program.first[FLOWS + 1]):
        kind, coefficient, drop = program.kind[k], program.value[k, 0], pressure_a - pressure_b
        if kind == EXTERNAL_A:
            from_a += coefficient * (pressure_a - tank)
        elif kind == EXTERNAL_B:
            from_b += coefficient * (pressure_b - tank)
        else:
            if kind == INTERNAL_ORIFICE:
                drop = math.copysign(math.sqrt(abs(drop) * MEETING_POINT), drop)
            from_a += coefficient * drop
            from_b -= coefficient * drop
    return from_a, from_b


@njit(cache=True)
def stiffness(program, modulus, pressure):
    """Bulk modulus [Pa] at a pressure [Pa]."""
    for k in range(program.first[STIFFNESS], program.first[STIFFNESS + 1]):
        if program.kind[k] == MODULUS:
            modulus *= program.value[k, 0]
        else:
            modulus = _with_air(modulus, pressure, program.value[k, 0], program.value[k, 1])
    return modulus


@njit(cache=True)
def _with_air(modulus, pressure, share, exponent):
    """Volumes o of oil and g of polytropic air, compressed in parallel: (o + g) / (o / beta + g / (n p))."""
    gauge = max(pressure, 0.0)
    absolute = gauge + ATMOSPHERE
    air = share * (ATMOSPHERE / absolute) ** (1.0 / exponent)
    oil = (1.0 - share) * math.exp(-gauge / modulus)
    return (oil + air) / (oil / modulus + air / (exponent * absolute))
