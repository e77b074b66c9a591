# SPDX-License-Identifier: Apache-2.0
"""The textbook equations of the bench, written once: servo valve, two oil chambers, mass, spring, load-cell amplifier.

They hold for numbers, for arrays of samples and for CasADi's symbols alike: numpy's functions act on all three, and
`choose` does what `np.where` does. What is symbolic becomes C, with exact derivatives (`model.assembly`)::

    p_a' = beta/V_a (q_a - A_p x_p')           V_a = V_dead_a + A_p x_p
    p_b' = beta/V_b (alpha A_p x_p' - q_b)     V_b = V_dead_b + alpha A_p (L_c - x_p)
    m x_p'' = f_h - b x_p' - f_l - f_stop      f_h = A_p p_a - alpha A_p p_b,  f_l = k_s (x_p - x_rest)

`n` is everywhere the bench's numbers, by their names in bench.yaml. Source: paper eq. q13-q15 and q4, physics.md.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Symbol = Any
"""A number, an array or a CasADi expression; in a model that is being assembled, an expression."""

LOAD_CELL_DAMPING = math.sqrt(0.5)
"""Damping of the load cell's amplifier: Butterworth, so that `load_cell_bandwidth` is where it has lost 3 dB."""

LAMINAR = 100.0
"""Pressure drop [Pa] below which flow through an edge is proportional to the pressure drop, so that its slope is
finite. With this little, p_a = p_s of a blocked cylinder is reached as by the square root, except the last 100 Pa."""

STOP_STIFFNESS = 1e7
"""Stiffness [N/m] of the end stops: the largest hydraulic force presses 0.3 mm into them."""

STOP_DAMPING = 4e3
"""Damping [N s/m] of the end stops while pressed, about critical: the piston does not bounce."""


def choose(condition: Symbol, first: Symbol, second: Symbol) -> Symbol:
    """`first` where the condition holds, else `second`. Its derivative is that of the side which it is on."""
    if not any(hasattr(value, "is_scalar") for value in (condition, first, second)):
        return np.where(condition, first, second)
    from casadi import if_else

    return if_else(condition, first, second)


def clip(value: Symbol, low: Symbol, high: Symbol) -> Symbol:
    """The value, held within its bounds."""
    return np.fmin(np.fmax(value, low), high)


def orifice(opening: Symbol, drop: Symbol) -> Symbol:
    """Flow [m3/s] through an edge open by `opening` [m3/s/sqrt(Pa)] at a pressure drop [Pa]; reverses with it."""
    size = np.abs(drop)
    return opening * np.copysign(np.sqrt(np.fmax(size, LAMINAR)) * np.fmin(size * (1.0 / LAMINAR), 1.0), drop)


def volumes(n: Symbol, position: Symbol) -> tuple[Symbol, Symbol]:
    """Oil volumes V_a, V_b [m3] at piston position [m]."""
    volume_a = n.dead_volume_a + n.piston_area * position
    return volume_a, n.dead_volume_b + n.area_ratio * n.piston_area * (n.stroke - position)


def compression(modulus: Symbol, volume: Symbol, inflow: Symbol) -> Symbol:
    """Rate of a chamber's pressure [Pa/s]: what flows in [m3/s] and is not displaced, compresses."""
    return modulus / volume * inflow


def hydraulic_force(n: Symbol, pressure_a: Symbol, pressure_b: Symbol) -> Symbol:
    """f_h [N], positive outwards."""
    return n.piston_area * (pressure_a - n.area_ratio * pressure_b)


def spring_force(n: Symbol, position: Symbol) -> Symbol:
    """f_l [N] of the spring on its load cell, positive when pressed."""
    return n.spring_stiffness * (position - n.spring_rest_position)


def stop_force(n: Symbol, position: Symbol, velocity: Symbol) -> Symbol:
    """Force [N] against the piston from the end stops; they push back and never pull."""
    pressed = position - clip(position, 0.0, n.stroke)
    force = STOP_STIFFNESS * pressed + STOP_DAMPING * velocity
    return (pressed > 0.0) * np.fmax(force, 0.0) + (pressed < 0.0) * np.fmin(force, 0.0)


def amplifier(omega: Symbol, force: Symbol, shown: Symbol, rate: Symbol) -> Symbol:
    """d2/dt2 [N/s2] of what the load cell's amplifier shows, a low-pass of `omega` [rad/s] on the force [N]."""
    return omega * (omega * (force - shown) - 2.0 * LOAD_CELL_DAMPING * rate)
