# SPDX-License-Identifier: Apache-2.0
"""Dry friction: its level, and its three forms (static, smooth, LuGre).

LuGre: z' = v - sigma_0 |v| / g(v) z,  F = sigma_0 z + sigma_1 z'.  Source: Canudas de Wit, Olsson, Astrom, Lischinsky,
"A new model for control of systems with friction", IEEE TAC 40(3), 1995.
"""

from __future__ import annotations

import math

from hydro_sim.emulator.truth.parameters import LUGRE, SMOOTH, SUBSTEP
from hydro_sim.jit import njit

ROUNDING = 1e-3  # m/s, over which the smooth form turns the sign


@njit
def friction_level(p, velocity, position, pressure_drop):
    """Strength g [N] of dry friction at a velocity [m/s], a position [m] and a pressure across the seal [Pa]."""
    level = p.coulomb_positive if velocity >= 0.0 else p.coulomb_negative
    if p.breakaway > 0.0:
        level += p.breakaway * math.exp(-((abs(velocity) / p.stribeck_velocity) ** p.stribeck_exponent))
    if p.rib_force > 0.0:
        level += 0.5 * p.rib_force * (1.0 + math.sin(2.0 * math.pi * position / p.rib_pitch))
    return level + p.seal_friction * abs(pressure_drop)


@njit
def advance_bristle(p, bristle, velocity, level):
    """Deflection z [m] one substep later: exact at constant velocity, so that no velocity makes it stiff."""
    if level <= 0.0:
        return 0.0
    decay = p.bristle_stiffness * abs(velocity) / level
    if decay * SUBSTEP < 1e-9:
        return bristle + SUBSTEP * velocity
    steady = level / p.bristle_stiffness * (1.0 if velocity > 0.0 else -1.0)
    return steady + (bristle - steady) * math.exp(-decay * SUBSTEP)


@njit
def dry_friction(p, velocity, bristle, level, other_force):
    """Force [N] on the mass, against motion; `other_force` [N] sums all others, which sticking must balance."""
    if level <= 0.0:
        return 0.0
    if p.friction_form == LUGRE:
        slip = velocity - p.bristle_stiffness * abs(velocity) / level * bristle
        return -p.bristle_stiffness * bristle - p.bristle_damping * slip * math.exp(-((velocity / 0.01) ** 2))
    if p.friction_form == SMOOTH:
        return -level * velocity / math.sqrt(velocity * velocity + ROUNDING * ROUNDING)
    # static: whatever brings the mass to rest within the substep, as far as friction reaches
    holding = -(p.mass * velocity / SUBSTEP + other_force)
    return min(max(holding, -level), level)
