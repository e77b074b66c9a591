# SPDX-License-Identifier: Apache-2.0
"""What resists the piston beyond viscous friction, and the load. Compiled.

Dry friction brings the mass to rest within a Runge-Kutta step as far as its level [N] reaches, so that sticking is
exact. With bristles nothing sticks: dF/dx = sigma (1 - F sign(x_p')/level), solved exactly along a step. Sources:
Armstrong-Helouvry et al. 1994, eq. 5; Dahl 1968.
"""

from __future__ import annotations

import math

from numba import njit

from hydro_sim.model.effects.record import DRAG, LOAD, RESISTANCE

COULOMB, COULOMB_DIRECTIONAL, STRIBECK = range(3)
"""Kinds of DRAG. Numbers: force | forces while extending, retracting | force, velocity."""

PRESLIDING, FORCE, VISCOUS, CUSHION_END, CUSHION_START, CUSHION_END_QUADRATIC, CUSHION_START_QUADRATIC = range(7)
"""Kinds of RESISTANCE. Numbers: stiffness | force | coefficients while extending, retracting | stiffness, position."""

HARDENING, GAP, PLAY = range(3)
"""Kinds of LOAD. Number: coefficient | width | width."""

QUADRATIC_DEPTH = 5e-3
"""m, at which a quadratic cushion has the force of the linear one."""

STANDSTILL = 1e-9
"""m/s, the least speed at which a level that depends on the direction is taken."""

LEVEL_MIN = 1e-6
"""N, below which a bristle's level counts as this."""


@njit(cache=True)
def begin(memory, position):
    """Bristles relaxed, the gap's middle where the piston is."""
    memory.bristle, memory.bristle_position, memory.dragged = 0.0, position, position


@njit(cache=True)
def _level(program, velocity):
    """Dry friction [N] while sliding."""
    level = 0.0
    for k in range(program.first[DRAG], program.first[DRAG + 1]):
        kind, value = program.kind[k], program.value[k]
        if kind == COULOMB:
            level += value[0]
        elif kind == COULOMB_DIRECTIONAL:
            level += value[0] if velocity > 0.0 else value[1]
        else:
            level += value[0] * math.exp(-((velocity / value[1]) ** 2))
    return level


@njit(cache=True)
def _bristle(memory, position, stiffness, level):
    """Force [N] of bristles that yield at `level` [N], after the way from where they were last taken."""
    moved = position - memory.bristle_position
    if moved == 0.0:
        return memory.bristle
    goal = math.copysign(level, moved)
    return goal + (memory.bristle - goal) * math.exp(-stiffness * abs(moved) / max(level, LEVEL_MIN))


@njit(cache=True)
def grip(program, mass, velocity, free, step):
    """What dry friction does within a step [s] that begins at a velocity and, without friction, an acceleration `free`.

    Returns
    -------
    Sign of the motion that it opposes (0: there is none), and the force [N] that brings the mass to rest, or nan if
    that is beyond its level.
    """
    if program.first[DRAG] == program.first[DRAG + 1] or _bristled(program):
        return 0.0, math.nan
    holding = mass * (velocity / step + free)
    sign = math.copysign(1.0, holding)
    reaches = abs(holding) < _level(program, sign * max(abs(velocity), STANDSTILL))
    return sign, holding if reaches else math.nan


@njit(cache=True)
def _bristled(program):
    bristled = False
    for k in range(program.first[RESISTANCE], program.first[RESISTANCE + 1]):
        bristled |= program.kind[k] == PRESLIDING
    return bristled


@njit(cache=True)
def dry(program, gripped, velocity):
    """Dry friction [N] against the motion, of what `grip` returned."""
    sign, holding = gripped
    if sign == 0.0:
        return 0.0
    return sign * _level(program, sign * max(abs(velocity), STANDSTILL)) if math.isnan(holding) else holding


@njit(cache=True)
def resistance(program, memory, position, velocity):
    """Force [N] against the motion beyond viscous and dry friction."""
    against = 0.0
    for k in range(program.first[RESISTANCE], program.first[RESISTANCE + 1]):
        kind, value = program.kind[k], program.value[k]
        if kind == PRESLIDING:
            against += _bristle(memory, position, value[0], _level(program, velocity))
        elif kind == FORCE:
            against -= value[0]
        elif kind == VISCOUS:
            against += (value[0] if velocity > 0.0 else value[1]) * velocity
        else:
            against += _cushion(kind, value[0], position - value[1])
    return against


@njit(cache=True)
def _cushion(kind, stiffness, depth):
    at_end = kind in (CUSHION_END, CUSHION_END_QUADRATIC)
    depth = max(depth, 0.0) if at_end else min(depth, 0.0)
    linear = kind in (CUSHION_END, CUSHION_START)
    return stiffness * depth * (1.0 if linear else abs(depth) / QUADRATIC_DEPTH)


@njit(cache=True)
def load(program, bench, memory, position):
    """Force [N] of the load."""
    deflection = position - bench.spring_rest_position
    force = bench.spring_stiffness * deflection
    for k in range(program.first[LOAD], program.first[LOAD + 1]):
        kind, number = program.kind[k], program.value[k, 0]
        if kind == HARDENING:
            force += number * deflection * deflection * deflection
        elif kind == GAP:
            force -= bench.spring_stiffness * min(max(deflection, -0.5 * number), 0.5 * number)
        else:
            force -= bench.spring_stiffness * (position - _dragged(memory, position, number))
    return force


@njit(cache=True)
def _dragged(memory, position, width):
    return min(max(memory.dragged, position - 0.5 * width), position + 0.5 * width)


@njit(cache=True)
def remember(program, memory, position, velocity):
    """Take bristles and gap where a Runge-Kutta step has ended."""
    for k in range(program.first[RESISTANCE], program.first[RESISTANCE + 1]):
        if program.kind[k] == PRESLIDING:
            memory.bristle = _bristle(memory, position, program.value[k, 0], _level(program, velocity))
            memory.bristle_position = position
    for k in range(program.first[LOAD], program.first[LOAD + 1]):
        if program.kind[k] == PLAY:
            memory.dragged = _dragged(memory, position, program.value[k, 0])
