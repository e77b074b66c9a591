# SPDX-License-Identifier: Apache-2.0
"""Forces of the load: its cell reads them too."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    AIR_SPRING,
    CARRIAGE,
    CENTRIFUGAL_BRAKE,
    COIL_CONTACT,
    COILS_TOUCH,
    CONICAL_SPRING,
    CROSS_WIRE,
    FOAM_BLOCK,
    FREEWHEEL,
    FRICTION_STRUT,
    GRIP_MASS,
    JAWS_SLIP,
    LEAF_SPRING,
    MAGNET_GAP,
    MEMORY,
    MEMORY_FOAM,
    MOUNT,
    REBOUND_DAMPER,
    RUBBER_QUICKENS,
    RUBBER_REMEMBERS,
    SPECIMEN_BEDS_IN,
    SPECIMEN_DAMPING,
    SPECIMEN_SOFTENS,
    SPRING_GUIDE,
    SPRING_HYSTERESIS,
    SPRING_PLATE_MASS,
    SPRING_RUBS_GUIDE,
    STOP_SPRING,
    UNBALANCED_MOTOR,
    WIRE_ROPE,
)
from benchmarks.foreign_truth.equations import CELL_RATE, POLYTROPIC, POSITION, VELOCITY, outside, rub, spring

WORKED = 0.1
"""m/s at which a specimen has warmed by 1 in the end."""
RUN_DOWN = 0.6
"""s in which the bearings of a flywheel stop it."""
MAGNET = 0.038
"""m, where a plate stands in the middle of a magnet's gap."""
STRETCHED = 5e-3
"""s in which rubber softens to a stretch that it has not had before."""


@njit
def extra_load(kind, size, shape, bench, time, state):
    """Force [N] that the load adds to its spring's at a time [s], but for a mass of its own."""
    position, velocity = state[POSITION], state[VELOCITY]
    if kind == SPRING_HYSTERESIS:
        return size * state[MEMORY]
    if kind in (MOUNT, JAWS_SLIP):
        return spring(bench, position - state[MEMORY]) - spring(bench, position)
    if kind in (STOP_SPRING, COIL_CONTACT, COILS_TOUCH):
        return size * max(position - shape, 0.0)
    if kind == REBOUND_DAMPER:
        return size * max(velocity, 0.0) ** 2
    if kind == LEAF_SPRING:
        stretch = abs(position - bench.spring_rest_position)
        return size * bench.spring_stiffness * stretch * math.tanh(velocity / shape)
    if kind == SPRING_RUBS_GUIDE:
        return size * abs(position - bench.spring_rest_position) * math.tanh(velocity / shape)
    if kind == SPECIMEN_DAMPING:
        return size * velocity
    if kind == CONICAL_SPRING:
        return size * max(position - bench.spring_rest_position, 0.0) ** 2
    if kind == SPECIMEN_BEDS_IN:
        return -size * math.exp(-time / shape) * spring(bench, position)
    if kind == WIRE_ROPE:
        return size * abs(position - bench.spring_rest_position) * state[MEMORY]
    if kind == AIR_SPRING:
        return size * ((1.0 - (position - bench.spring_rest_position) / shape) ** -POLYTROPIC - 1.0)
    if kind == FOAM_BLOCK:
        return size * max(position - bench.spring_rest_position, 0.0) * velocity
    if kind in (FRICTION_STRUT, SPRING_GUIDE):
        return size * math.tanh(velocity / shape)
    if kind == RUBBER_QUICKENS:
        return size * (position - bench.spring_rest_position) * abs(velocity)
    if kind == MEMORY_FOAM:
        return size * max(position - bench.spring_rest_position - state[MEMORY], 0.0)
    if kind == CROSS_WIRE:
        stretch = position - bench.spring_rest_position
        return size * stretch / math.sqrt(stretch**2 + shape**2)
    if kind == FREEWHEEL:
        return size * max(velocity - state[MEMORY], 0.0)
    if kind == UNBALANCED_MOTOR:
        return size * math.sin(2.0 * math.pi * time / shape)
    if kind == RUBBER_REMEMBERS:
        stretch = position - bench.spring_rest_position
        return -size * (state[MEMORY] - abs(stretch)) * stretch
    if kind == MAGNET_GAP:
        return size * math.exp(-(((position - MAGNET) / shape) ** 2)) * velocity
    if kind == CENTRIFUGAL_BRAKE:
        return size * math.copysign(max(velocity**2 - shape**2, 0.0), velocity)
    return -size * state[MEMORY] * spring(bench, position) if kind == SPECIMEN_SOFTENS else 0.0


@njit
def mass(kind, size):
    """Mass [kg] that the load's cell accelerates."""
    return size if kind in (GRIP_MASS, CARRIAGE, SPRING_PLATE_MASS) else 0.0


@njit
def brake(kind, size, bench, state, seconds):
    """Let the piston's dry friction act for a while on the load's mass too: its cell reads that."""
    before, carried = state[VELOCITY], mass(kind, size)
    rub(bench, state, seconds * bench.moving_mass / (bench.moving_mass + carried))
    corner = 2.0 * math.pi * bench.load_cell_bandwidth
    state[CELL_RATE] += corner**2 * carried * (state[VELOCITY] - before)


@njit
def memory_rate(kind, size, shape, bench, state):
    """Rate of a spring's or rope's path, of a foot, foam or stretch [m/s], of a flywheel [m/s2], of warmth."""
    memory, velocity = state[MEMORY], state[VELOCITY]
    if kind in (SPRING_HYSTERESIS, WIRE_ROPE):
        return (velocity - abs(velocity) * memory) / shape
    if kind == MOUNT:
        load = spring(bench, state[POSITION] - memory)
        return (size * load / bench.spring_stiffness - memory) / shape
    if kind == MEMORY_FOAM:
        return (state[POSITION] - bench.spring_rest_position - state[MEMORY]) / shape
    if kind == FREEWHEEL:
        return max(velocity - memory, 0.0) / shape - memory / RUN_DOWN
    if kind == RUBBER_REMEMBERS:
        return max(abs(state[POSITION] - bench.spring_rest_position) - memory, 0.0) / STRETCHED - memory / shape
    if kind == JAWS_SLIP:
        return size * outside(spring(bench, state[POSITION] - memory), shape)
    return (abs(velocity) / WORKED - memory) / shape if kind == SPECIMEN_SOFTENS else 0.0
