# SPDX-License-Identifier: Apache-2.0
"""The truth plant in time: Heun's method in steps of 25 us on oil contents, motion, spool and supply.

    content_a' = (q_sa - q_at - q_ab - q_ea) / v(p_a)        content_b' likewise
    m x'' = A_a p_a - A_b p_b - b x' - f_l + dry friction + ends + disturbance

The bristle deflection and the spring's dragged end are advanced once per step, between the steps of the others.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.emulator.truth import friction, load, oil, valve
from hydro_sim.emulator.truth.parameters import DELAY_SAMPLES, LUGRE, SUBSTEP, SUBSTEPS
from hydro_sim.jit import njit

STANDSTILL = 1e-5  # m/s, below which a direction of motion says nothing

CONTENT_A, CONTENT_B, POSITION, VELOCITY, SPOOL, SPOOL_RATE, SUPPLY, HYSTERESIS = range(8)

STATE = np.dtype(
    [
        ("y", np.float64, (8,)),  # the integrated state, in the order above
        ("bristle", np.float64),  # m
        ("spring_end", np.float64),  # m
        ("walk", np.float64),  # random force, in units of its deviation
        ("pressure_a", np.float64),  # Pa, at y
        ("pressure_b", np.float64),
        ("hydraulic_force", np.float64),  # N, at y
        ("load_force", np.float64),
        ("hydraulic_force_rate", np.float64),  # N/s, over the last step
        ("load_force_rate", np.float64),
        ("friction_force", np.float64),  # N, dry and viscous, against motion
        ("draw", np.float64),  # m3/s, what the valve takes from the supply
        ("commands", np.float64, (DELAY_SAMPLES,)),  # A, ring of past commands
        ("sample", np.int64),
    ]
)
"""State of the physical plant."""


@njit
def rest_state(p, state):
    """Put the bench at rest: spring relaxed, spool at null, pressures where small motions to both sides leave them."""
    ratio = p.area_b / p.area_a
    state.y[:] = 0.0
    state.y[POSITION] = state.spring_end = p.rest
    state.y[SPOOL] = p.valve_offset
    state.y[SUPPLY] = p.source_pressure
    drop = p.source_pressure - p.tank_pressure
    state.pressure_b = p.tank_pressure + 0.5 * drop * (1.0 + ratio**2) / (1.0 + ratio**3)
    state.pressure_a = ratio * state.pressure_b
    state.y[CONTENT_A] = oil.content_of(p, state.pressure_a, p.dead_volume_a + p.area_a * p.rest)
    state.y[CONTENT_B] = oil.content_of(p, state.pressure_b, p.dead_volume_b + p.area_b * (p.stroke - p.rest))
    state.bristle = state.walk = 0.0
    state.commands[:] = 0.0
    state.sample = 0
    _settle(p, state)
    state.hydraulic_force_rate = state.load_force_rate = state.friction_force = state.draw = 0.0


@njit
def _settle(p, state):
    """Pressures and forces that belong to y."""
    y = state.y
    state.pressure_a = oil.pressure_of(p, y[CONTENT_A], p.dead_volume_a + p.area_a * y[POSITION], state.pressure_a)
    volume_b = p.dead_volume_b + p.area_b * (p.stroke - y[POSITION])
    state.pressure_b = oil.pressure_of(p, y[CONTENT_B], volume_b, state.pressure_b)
    state.hydraulic_force = p.area_a * state.pressure_a - p.area_b * state.pressure_b
    state.load_force = load.load_force(p, y[POSITION], state.spring_end, y[HYSTERESIS])


@njit
def _derivative(p, state, y, pressure_a, pressure_b, time, command, slope):
    """Slope of y at pressures that belong to y; leaves friction force and draw in `state`."""
    spool = y[SPOOL] if p.spool_order > 0.0 else command + p.valve_offset
    supply = y[SUPPLY]
    if p.ripple_amplitude > 0.0:
        supply += p.ripple_amplitude * math.sin(2.0 * math.pi * p.ripple_frequency * time)
    gain = valve.gain_over_time(p, time)
    into_a, out_of_a, into_b, out_of_b = valve.edge_flows(p, spool, gain, pressure_a, pressure_b, supply)
    across = valve.leak_a_to_b(p, pressure_a - pressure_b)
    lost_a = p.leak_external_a * (pressure_a - p.tank_pressure)
    lost_b = p.leak_external_b * (pressure_b - p.tank_pressure)
    state.draw = into_a + into_b
    slope[CONTENT_A] = (into_a - out_of_a - across - lost_a) / oil.specific_volume(p, pressure_a)[0]
    slope[CONTENT_B] = (into_b - out_of_b + across - lost_b) / oil.specific_volume(p, pressure_b)[0]
    slope[SPOOL], slope[SPOOL_RATE] = valve.spool_derivative(p, command, y[SPOOL], y[SPOOL_RATE])
    slope[SUPPLY] = (p.source_pressure - p.droop_resistance * state.draw - y[SUPPLY]) / p.droop_time
    slope[HYSTERESIS] = load.hysteresis_derivative(p, y[HYSTERESIS], y[VELOCITY])
    slope[POSITION] = y[VELOCITY]
    slope[VELOCITY] = _acceleration(p, state, y, pressure_a, pressure_b, time)


@njit
def _acceleration(p, state, y, pressure_a, pressure_b, time):
    position, velocity = y[POSITION], y[VELOCITY]
    force = p.area_a * pressure_a - p.area_b * pressure_b - p.viscous * velocity
    force += load.end_force(p, position, velocity) + load.disturbance(p, time, state.walk)
    force -= load.load_force(p, position, load.dragged(p, position, state.spring_end), y[HYSTERESIS])
    # at standstill friction opposes where the other forces would move the mass, with the level of that direction
    sticks = p.friction_form != LUGRE and abs(velocity) < STANDSTILL
    heading = math.copysign(STANDSTILL, force) if sticks else velocity
    level = friction.friction_level(p, heading, position, pressure_a - pressure_b)
    dry = friction.dry_friction(p, velocity, state.bristle, level, force)
    state.friction_force = p.viscous * velocity - dry
    return (force + dry) / p.mass


@njit
def _heun_step(p, state, time, command, work):
    y, guess, slope, slope_ahead = state.y, work[0], work[1], work[2]
    if p.friction_form == LUGRE:
        level = friction.friction_level(p, y[VELOCITY], y[POSITION], state.pressure_a - state.pressure_b)
        state.bristle = friction.advance_bristle(p, state.bristle, y[VELOCITY], level)  # lives half a step ahead of y
    _derivative(p, state, y, state.pressure_a, state.pressure_b, time, command, slope)
    for i in range(8):
        guess[i] = y[i] + SUBSTEP * slope[i]
    volume_a = p.dead_volume_a + p.area_a * guess[POSITION]
    volume_b = p.dead_volume_b + p.area_b * (p.stroke - guess[POSITION])
    pressure_a = oil.pressure_of(p, guess[CONTENT_A], volume_a, state.pressure_a)
    pressure_b = oil.pressure_of(p, guess[CONTENT_B], volume_b, state.pressure_b)
    _derivative(p, state, guess, pressure_a, pressure_b, time + SUBSTEP, command, slope_ahead)
    for i in range(8):
        y[i] += 0.5 * SUBSTEP * (slope[i] + slope_ahead[i])
    y[SPOOL_RATE] = min(max(y[SPOOL_RATE], -p.spool_rate_limit), p.spool_rate_limit)
    if p.spool_order == 0.0:
        y[SPOOL] = command + p.valve_offset
    state.spring_end = load.dragged(p, y[POSITION], state.spring_end)


@njit
def hold_command(p, state, current, walk_noise):
    """Begin a sample: store its valve current [A] and draw the random force's next value."""
    state.commands[state.sample % DELAY_SAMPLES] = current
    if p.walk_force > 0.0:
        kept = math.exp(-SAMPLE_PERIOD / p.walk_time)
        state.walk = kept * state.walk + math.sqrt(1.0 - kept * kept) * walk_noise


@njit
def advance_substep(p, state, index, work):
    """Advance by substep `index` of the present sample, in place; `work` is scratch space, shape (3, 8)."""
    elapsed = index * SUBSTEP
    time = state.sample * SAMPLE_PERIOD + elapsed
    # the command is constant within a step; both of Heun's slopes must see the same side of its jumps
    command = valve.delayed_command(p, state.commands, state.sample, elapsed)
    force_h, force_l = state.hydraulic_force, state.load_force
    _heun_step(p, state, time, command, work)
    _settle(p, state)
    state.hydraulic_force_rate = (state.hydraulic_force - force_h) / SUBSTEP
    state.load_force_rate = (state.load_force - force_l) / SUBSTEP
    if index == SUBSTEPS - 1:
        state.sample += 1
