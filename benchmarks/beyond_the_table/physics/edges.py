# SPDX-License-Identifier: Apache-2.0
"""Flows that the valve's edges would have passed, were it ideal."""

from __future__ import annotations

import math

from numba import njit

from benchmarks.beyond_the_table.physics.places import (
    EDGE_CHOKES,
    LANDS_APART,
    MEMORY,
    NEIGHBOUR_STROKES,
    PIPE_INERTIA,
    PORT_COVERED,
    RETURN_FILTER,
    RETURN_POT,
    SILTED_EDGE,
    SUPPLY_HUNTS,
    SUPPLY_SETS,
    TRANSITION,
)
from benchmarks.foreign_truth.equations import POSITION, PRESSURE_A, PRESSURE_B, flow_gain, opening, root


@njit
def drops(bench, out, state):
    """Pressure [Pa] that each chamber's open edge takes, driving the piston out or in."""
    a, b = state[PRESSURE_A], state[PRESSURE_B]
    if out:
        return bench.supply_pressure - a, b - bench.tank_pressure
    return a - bench.tank_pressure, bench.supply_pressure - b


@njit
def blocked_flows(kind, size, shape, bench, time, current, state):
    """Flows [m3/s] that the edges do not pass: into chamber A and out of chamber B, as `lost_flows` counts them."""
    if kind not in (TRANSITION, RETURN_FILTER, SILTED_EDGE, EDGE_CHOKES, SUPPLY_SETS, RETURN_POT, PORT_COVERED,
                    NEIGHBOUR_STROKES, LANDS_APART, PIPE_INERTIA, SUPPLY_HUNTS):  # fmt: skip
        return 0.0, 0.0
    moved = flow_gain(bench) * opening(bench, time, current)
    out = moved >= 0.0
    over_a, over_b = drops(bench, out, state)
    if kind == SILTED_EDGE:
        return 0.0, -size * max(moved, 0.0) * root(over_b)
    if kind == TRANSITION:
        short_a = root(over_a) - over_a / math.sqrt(abs(over_a) + size)
        short_b = root(over_b) - over_b / math.sqrt(abs(over_b) + size)
        return moved * short_a, -moved * short_b
    if kind == EDGE_CHOKES:
        over = over_b if out else over_a
        short = moved * (root(over) - root(over - size * max(over - shape, 0.0)))
        return (0.0, -short) if out else (short, 0.0)
    if kind == SUPPLY_SETS:
        over = over_a if out else over_b
        short = moved * (root(over) - root(over - size * (1.0 - math.exp(-time / shape))))
        return (short, 0.0) if out else (0.0, -short)
    if kind == NEIGHBOUR_STROKES:
        over = over_a if out else over_b
        sag = size if time % shape >= 0.5 * shape else 0.0
        short = moved * (root(over) - root(over - sag))
        return (short, 0.0) if out else (0.0, -short)
    if kind == SUPPLY_HUNTS:
        over = over_a if out else over_b
        short = moved * (root(over) - root(over + size * math.sin(2.0 * math.pi * shape * time)))
        return (short, 0.0) if out else (0.0, -short)
    if kind == PORT_COVERED:
        return size * max(shape - state[POSITION], 0.0) * moved * root(over_a), 0.0
    if kind == RETURN_POT:
        over = over_b if out else over_a
        short = moved * (root(over) - root(over - state[MEMORY]))
        return (0.0, -short) if out else (short, 0.0)
    if kind == PIPE_INERTIA:
        return (moved * root(over_a) - state[MEMORY] if size > 0.0 else 0.0), 0.0
    if kind == LANDS_APART:
        moved_a = flow_gain(bench) * opening(bench, time, current + size)
        moved_b = flow_gain(bench) * opening(bench, time, current - size)
        apart_a, apart_b = drops(bench, moved_a >= 0.0, state)[0], drops(bench, moved_b >= 0.0, state)[1]
        return moved * root(over_a) - moved_a * root(apart_a), moved_b * root(apart_b) - moved * root(over_b)
    # q = moved sqrt(over - size q^2), solved for q: only the edge to the tank has the filter behind it
    short = moved * (1.0 - 1.0 / math.sqrt(1.0 + size * moved**2))
    return (0.0, -short * root(over_b)) if out else (short * root(over_a), 0.0)
