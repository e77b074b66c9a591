# SPDX-License-Identifier: Apache-2.0
"""Rates of a bench's states: the textbook's equations with the terms of its effects, and stick-slip of the mass.

Dry friction is an exact event within an integration step: if its level suffices, it brings the mass to rest within the
step, and then holds it: the velocity is exactly 0. Otherwise it acts against the motion at its level.
Derivatives are one-sided: a mass that is held stays held under small changes of state and input.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from hydro_sim.model import equations as eq
from hydro_sim.model.effects.base import Effect, EffectContext
from hydro_sim.model.equations import Symbol, choose

EdgeConductances = tuple[Symbol, Symbol, Symbol, Symbol]
"""Conductances [m3/s/sqrt(Pa)] of the four edges (`equations.EDGES`)."""


def dry_level(effects: Sequence[Effect], velocity: Symbol) -> Symbol:
    """Return the dry friction [N] while sliding at a velocity [m/s]."""
    level: Symbol = 0.0
    for effect in effects:
        level = effect.dry_level(level, velocity)
    return level


def load_force(n: Any, effects: Sequence[Effect], position: Symbol) -> Symbol:
    """Return the load force f_l [N] at a piston position [m]."""
    force = eq.spring_force(n, position)
    for effect in effects:
        force = effect.load(force, position)
    return force


def added_mass(effects: Sequence[Effect], position: Symbol) -> Symbol:
    """Return the mass [kg] moved with the load at a piston position [m]; 0.0 without such an effect."""
    dragging = [effect for effect in effects if effect.acts_in("inertia")]
    return sum(effect.inertia(position) for effect in dragging) if dragging else 0.0


def textbook_rates(
    at: EffectContext,
    effects: Sequence[Effect],
    y: Sequence[Symbol],
    edges: EdgeConductances,
    dry: Callable[[Symbol], Symbol],
) -> tuple[list[Symbol], Symbol]:
    """Return y', of length 6, and the flow out of the supply [m3/s]; `dry`: dry friction [N] by velocity [m/s].

    `at`: context of the effects, to which this writes the state.
    """
    n, (p_a, p_b, position, velocity, shown, shown_rate) = at.bench, y[:6]
    at.position, at.velocity, at.pressures, at.load_force = position, velocity, (p_a, p_b), shown
    # the valve
    (edge_pa, edge_at, edge_pb, edge_bt), supply, tank = edges, n.supply_pressure, n.tank_pressure
    for effect in effects:
        supply, tank = effect.supply(supply), effect.tank(tank)
    drops_out, drops_back = eq.edge_drops(supply, tank, p_a, p_b)
    if any(effect.all_edges for effect in effects):
        drawn_a, drawn_b = eq.orifice(edge_pa, drops_out[0]), eq.orifice(edge_pb, drops_back[1])
        into_a, into_b = drawn_a - eq.orifice(edge_at, drops_back[0]), drawn_b - eq.orifice(edge_bt, drops_out[1])
        drawn = drawn_a + drawn_b
    else:
        outwards, opening = edge_pa > 0.0, edge_pa - edge_at  # one of the two is closed
        into_a = eq.orifice(opening, choose(outwards, drops_out[0], drops_back[0]))
        into_b = -eq.orifice(opening, choose(outwards, drops_out[1], drops_back[1]))
        drawn = choose(outwards, into_a, into_b)
    at.returned = drawn - into_a - into_b
    # the chambers
    modulus_a = modulus_b = n.bulk_modulus
    for effect in effects:
        from_a, from_b = effect.leaks(p_a, p_b)
        into_a, into_b = into_a - from_a, into_b - from_b
        modulus_a, modulus_b = effect.modulus(modulus_a, p_a), effect.modulus(modulus_b, p_b)
    stiff = eq.stiffnesses(n, (modulus_a, modulus_b), position)
    rate_a, rate_b = eq.pressure_rates(n, stiff, (into_a, into_b), velocity)
    # mass, load and load cell
    force = load_force(n, effects, position)
    against = n.viscous_friction * velocity + eq.stop_force(n, position, velocity) + dry(velocity)
    for effect in effects:
        against = against + effect.opposing_force(position, velocity)
    dragged = added_mass(effects, position)
    driving = eq.hydraulic_force(n, p_a, p_b) - against - force
    acceleration = driving * n.mobility if isinstance(dragged, float) else driving / (n.moving_mass + dragged)
    force = force + dragged * acceleration
    ideal = n.load_cell_omega is None
    cell = 0.0 if ideal else eq.amplifier_acceleration(n.load_cell_omega, force, shown, shown_rate)
    return [rate_a, rate_b, velocity, acceleration, shown_rate, cell], drawn


STANDSTILL_VELOCITY = 1e-9
"""Smallest speed [m/s] at which a level that depends on the direction is evaluated."""
FrictionFunction = Callable[[Symbol], Symbol]
"""Function of a velocity [m/s]: a force [N] against the motion, or the velocity at the end of a step."""


def stick_slip_friction(
    level: FrictionFunction, mass: Symbol, velocity: Symbol, free: Symbol, step: float
) -> tuple[FrictionFunction, FrictionFunction]:
    """Return the dry friction of `level` over a step [s] with stick-slip: functions for the step and for its end.

    The step begins at a velocity [m/s] and, without friction, an acceleration `free` [m/s2].
    """
    holding = mass * (velocity / step + free)
    sign = choose(holding >= 0.0, 1.0, -1.0)

    def reach(velocity: Symbol) -> Symbol:
        return level(sign * np.fmax(np.abs(velocity), STANDSTILL_VELOCITY))

    held = np.abs(holding) < reach(velocity)
    return lambda v: choose(held, holding, sign * reach(v)), lambda v: choose(held, 0.0, v)
