# SPDX-License-Identifier: Apache-2.0
"""The textbook equations of the bench, written once: servo valve, two oil chambers, mass, spring, load-cell amplifier.

They accept numbers, arrays of samples, torch's tensors and CasADi's symbols alike, and compile with numba
(`model.compiled_equations`): numpy's functions act on all but tensors, and `choose` does what `np.where` does.
Symbolic results become C, with exact derivatives (`model.assembly`)::

    p_a' = beta/V_a (q_a - A_p x_p')           V_a = V_dead_a + A_p x_p
    p_b' = beta/V_b (alpha A_p x_p' - q_b)     V_b = V_dead_b + alpha A_p (L_c - x_p)
    m x_p'' = f_h - b x_p' - f_l - f_stop      f_h = A_p p_a - alpha A_p p_b,  f_l = k_s (x_p - x_rest)

`n` is everywhere an object with the bench's parameters, named as in bench.yaml: a `Bench`, a record, a named tuple.
Flows count into chamber A and into chamber B, -q_b. Source: paper eq. q13-q15 and q4, physics.md.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Symbol = Any
"""A number, an array or a CasADi expression; in a model that is being assembled, an expression."""
Pair = tuple[Symbol, Symbol]
"""Values for chamber A and for chamber B."""
READINGS = ("hydraulic_force", "load_force", "pressure_a", "pressure_b", "piston_position")
"""Names of the sensors' readings, in the order of every array of readings."""
LOAD_CELL_DAMPING = math.sqrt(0.5)
"""Damping of the load cell's amplifier: Butterworth, so that `load_cell_bandwidth` is its -3 dB frequency."""
TRANSITION_DROP = 100.0
"""Pressure drop [Pa] below which flow through an edge is proportional to the pressure drop, so that its slope is
finite. With this little, p_a = p_s of a blocked cylinder is reached as by the square root, except the last 100 Pa."""

STOP_STIFFNESS = 1e7
"""Stiffness [N/m] of the end stops: the largest hydraulic force presses 0.3 mm into them."""
STOP_DAMPING = 4e3
"""Damping [N s/m] of the end stops while pressed, about critical: the piston does not bounce."""


EDGES = ("pa", "at", "pb", "bt")
"""Edges of the valve, from port to port: supply to A, A to tank, supply to B, B to tank."""
OPENS_BACK = (False, True, True, False)
"""Whether each of `EDGES` opens where the piston is driven back."""


def choose(condition: Symbol, first: Symbol, second: Symbol) -> Symbol:
    """`first` where the condition holds, else `second`; the derivative is that of the chosen one."""
    if not any(hasattr(value, "is_scalar") for value in (condition, first, second)):
        return np.where(condition, first, second)
    from casadi import if_else

    return if_else(condition, first, second)


def clip(value: Symbol, low: Symbol, high: Symbol) -> Symbol:
    """The value, clipped to its bounds."""
    return np.fmin(np.fmax(value, low), high)


# --- the valve's edges: pressure drops, and the flow that each drives ------------------------------------------------


def edge_drops(supply: Symbol, tank: Symbol, pressure_a: Symbol, pressure_b: Symbol) -> tuple[Pair, Pair]:
    """Pressure drops [Pa] of the edges that drive the piston out, then of those that drive it back.

    Out: from the supply into A, from B into the tank. Back: from A into the tank, from the supply into B.
    """
    return (supply - pressure_a, pressure_b - tank), (pressure_a - tank, supply - pressure_b)


def signed_root(drop: Symbol) -> Symbol:
    """sqrt of a pressure drop [Pa], odd: flow through an edge reverses with the drop."""
    return np.copysign(np.sqrt(np.abs(drop)), drop)


def orifice(opening: Symbol, drop: Symbol) -> Symbol:
    """Flow [m3/s] through an edge open by `opening` [m3/s/sqrt(Pa)] at a pressure drop [Pa]; reverses with it."""
    size = np.abs(drop)
    return opening * np.copysign(
        np.sqrt(np.fmax(size, TRANSITION_DROP)) * np.fmin(size * (1.0 / TRANSITION_DROP), 1.0), drop
    )


# --- the chambers ----------------------------------------------------------------------------------------------------


def volumes(n: Symbol, position: Symbol) -> Pair:
    """Oil volumes V_a, V_b [m3] at piston position [m]."""
    volume_a = n.dead_volume_a + n.piston_area * position
    return volume_a, n.dead_volume_b + n.area_ratio * n.piston_area * (n.stroke - position)


def stiffnesses(n: Symbol, moduli: Pair, position: Symbol) -> Pair:
    """Hydraulic stiffness beta/V [Pa/m3] of both chambers at piston position [m]: pressure per added oil volume."""
    volume_a, volume_b = volumes(n, position)
    return moduli[0] / volume_a, moduli[1] / volume_b


def pressure_rates(n: Symbol, stiff: Pair, flows: Pair, velocity: Symbol) -> Pair:
    """p_a', p_b' [Pa/s] from `flows` [m3/s] into both chambers less the displacement flows at `velocity` [m/s].

    For volumes [m3] and a travel [m] in place of flows and velocity it gives pressure changes [Pa].
    """
    swept = n.piston_area * velocity
    return stiff[0] * (flows[0] - swept), stiff[1] * (flows[1] + n.area_ratio * swept)


def hydraulic_force(n: Symbol, pressure_a: Symbol, pressure_b: Symbol) -> Symbol:
    """f_h [N], positive outwards."""
    return n.piston_area * (pressure_a - n.area_ratio * pressure_b)


def force_rate(n: Symbol, stiff: Pair, flows: Pair, velocity: Symbol) -> Symbol:
    """f_h' [N/s] (eq. q13): the velocity term h for zero flows, the input gain g for flows per ampere at velocity 0."""
    rate_a, rate_b = pressure_rates(n, stiff, flows, velocity)
    return hydraulic_force(n, rate_a, rate_b)


def rest_state(n: Symbol) -> tuple[Symbol, ...]:
    """p_a, p_b, x_p, x_p', f_l and f_l' of a bench at rest with a relaxed spring and p_a + p_b = p_s."""
    pressure_b = n.supply_pressure / (1.0 + n.area_ratio)
    return n.area_ratio * pressure_b, pressure_b, n.spring_rest_position, 0.0, 0.0, 0.0


# --- motion and load -------------------------------------------------------------------------------------------------


def spring_force(n: Symbol, position: Symbol) -> Symbol:
    """f_l [N] of the spring on its load cell, positive when pressed."""
    return n.spring_stiffness * (position - n.spring_rest_position)


def stop_force(n: Symbol, position: Symbol, velocity: Symbol) -> Symbol:
    """Force [N] against the piston from the end stops; they push back and never pull."""
    pressed = choose(position < 0.0, position, choose(position > n.stroke, position - n.stroke, 0.0))
    force = STOP_STIFFNESS * pressed + STOP_DAMPING * velocity
    return choose(pressed * force > 0.0, force, 0.0)


def amplifier_acceleration(omega: Symbol, force: Symbol, shown: Symbol, rate: Symbol) -> Symbol:
    """Second derivative [N/s2] of the load cell amplifier's output, a low-pass of `omega` [rad/s] on the force [N]."""
    return omega * (omega * (force - shown) - 2.0 * LOAD_CELL_DAMPING * rate)
