# SPDX-License-Identifier: Apache-2.0
"""Load of the piston: spring, lost motion, hysteresis, cushions, end stops, disturbances."""

from __future__ import annotations

import math

from hydro_sim.jit import njit

STOP_STIFFNESS = 2e7  # N/m, metal on metal
STOP_DAMPING = 2e3  # N s/m


@njit
def spring_deflection(p, position, spring_end):
    """Deflection [m] of the spring; `spring_end` [m] is where its driven end lies in the `play` form."""
    if p.backlash == 0.0:
        return position - p.rest
    if p.backlash_play == 1.0:
        return spring_end - p.rest
    travel = position - p.rest
    return travel - min(max(travel, -0.5 * p.backlash), 0.5 * p.backlash)


@njit
def dragged(p, position, spring_end):
    """Spring end [m] after the piston moved to `position` [m]: it stays while the piston crosses the play."""
    return min(max(spring_end, position - 0.5 * p.backlash), position + 0.5 * p.backlash)


@njit
def load_force(p, position, spring_end, hysteresis):
    """Force [N] between mass and load, positive when it resists extension."""
    deflection = spring_deflection(p, position, spring_end)
    return (p.stiffness + p.hardening * deflection * deflection) * deflection + p.hysteresis_force * hysteresis


@njit
def hysteresis_derivative(p, hysteresis, velocity):
    """Rate [1/s] of the Bouc-Wen element's state w in [-1, 1]."""
    if p.hysteresis_force == 0.0:
        return 0.0
    size = abs(hysteresis) ** p.hysteresis_exponent
    toward = 1.0 if hysteresis >= 0.0 else -1.0
    return (velocity - 0.5 * (abs(velocity) * toward + velocity) * size) / p.hysteresis_deflection


@njit
def end_force(p, position, velocity):
    """Force [N] of cushions and end stops on the mass."""
    force = _cushion(p, p.cushion_low - position, p.cushion_low_stiffness)
    force -= _cushion(p, position - p.cushion_high, p.cushion_high_stiffness)
    if position < 0.0:
        force += max(-STOP_STIFFNESS * position - STOP_DAMPING * velocity, 0.0)  # a stop does not pull
    elif position > p.stroke:
        force -= max(STOP_STIFFNESS * (position - p.stroke) + STOP_DAMPING * velocity, 0.0)
    return force


@njit
def _cushion(p, depth, stiffness):
    if depth <= 0.0:
        return 0.0
    return stiffness * depth * depth if p.cushion_quadratic == 1.0 else stiffness * depth


@njit
def disturbance(p, time, walk):
    """Force [N] on the mass from outside at `time` [s]; `walk` is the random force in units of its deviation."""
    force = p.force_offset + p.walk_force * walk
    if p.hum_amplitude > 0.0:
        force += p.hum_amplitude * math.sin(2.0 * math.pi * p.hum_frequency * time)
    return force
