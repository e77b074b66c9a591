# SPDX-License-Identifier: Apache-2.0
"""The truth plant's equations, and their integration by Heun's method in steps of 25 us.

    content_a' = (q_sa - q_at - q_ab - q_ea) / v(p_a)        content_b' likewise
    m x'' = A_a p_a - A_b p_b - b x' - f_l + dry friction + ends + disturbance

The bristle deflection and the spring's dragged end are advanced once per step, between the steps of the others.

Oil. A chamber's state is its *content* W [m3]: the volume that its oil, free air included, would fill at zero gauge
pressure. Mass is conserved exactly, and pressure follows from the content's compression::

    V + c p = W v(p)        v(p) = (1 - phi) exp(-p / beta) + phi (p_0 / (p_0 + p))^(1/n)

with the chamber's volume V, the hoses' compliance c, the air fraction phi at atmospheric pressure p_0 and the exponent
n. A flow q [m3/s] at the chamber's pressure changes the content by q / v(p). For phi = c = 0 this is
p' = beta / V (q - V').

Valve. Spool positions are in amperes of the command that would hold them.

Dry friction is static, smooth or LuGre: z' = v - sigma_0 |v| / g(v) z,  F = sigma_0 z + sigma_1 z'. Source: Canudas de
Wit, Olsson, Astrom, Lischinsky, "A new model for control of systems with friction", IEEE TAC 40(3), 1995.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.emulator.truth.parameters import (
    ATMOSPHERIC_PRESSURE,
    DELAY_SAMPLES,
    LUGRE_FRICTION,
    NEVER_REACHED,
    SMOOTH_FRICTION,
    SUBSTEP_TIME,
    SUBSTEPS,
)
from hydro_sim.jit import njit

VAPOR_PRESSURE = -0.95 * ATMOSPHERIC_PRESSURE  # Pa, gauge: below it a cavity opens instead


@njit
def specific_volume(p, pressure):
    """Return the volume per content v(p) [-], and its slope dv/dp [1/Pa]."""
    oil = (1.0 - p.air_fraction) * math.exp(-pressure / p.bulk_modulus)
    if p.air_fraction == 0.0:
        return oil, -oil / p.bulk_modulus
    air = p.air_fraction * (ATMOSPHERIC_PRESSURE / (ATMOSPHERIC_PRESSURE + pressure)) ** (1.0 / p.air_exponent)
    return oil + air, -oil / p.bulk_modulus - air / (p.air_exponent * (ATMOSPHERIC_PRESSURE + pressure))


@njit
def pressure_of(p, content, volume, guess):
    """Return the pressure [Pa] of `content` [m3] in `volume` [m3], by Newton's method from `guess` [Pa]."""
    if p.air_fraction == 0.0 and p.wall_compliance == 0.0:
        return max(p.bulk_modulus * math.log(content / volume), VAPOR_PRESSURE)
    pressure = guess
    for _ in range(30):
        v, slope = specific_volume(p, pressure)
        change = (volume + p.wall_compliance * pressure - content * v) / (p.wall_compliance - content * slope)
        # v is convex and steep near the vapor pressure: never go more than half of the way there in one iteration
        pressure = max(pressure - change, 0.5 * (pressure + VAPOR_PRESSURE))
        if abs(change) < 1e-3:
            break
    return max(pressure, VAPOR_PRESSURE)


@njit
def content_of(p, pressure, volume):
    """Return the content [m3] that gives `pressure` [Pa] in `volume` [m3]."""
    v, _ = specific_volume(p, pressure)
    return (volume + p.wall_compliance * pressure) / v


TRANSITION_DROP = 2e3  # Pa: below about this an orifice's flow is laminar, so that its slope at zero drop is finite


@njit
def opening(p, travel, overlap):
    """Opening [A] of one edge, `travel` [A] being the spool's position in the edge's own direction."""
    if p.softness == 0.0:
        return max(travel - overlap, 0.0)
    return max(_soft(travel - overlap, p.softness) - _soft(-overlap, p.softness), 0.0)


@njit
def _soft(x, width):
    if x > 30.0 * width:
        return x
    return width * math.log1p(math.exp(x / width))


@njit
def null_leak(p, spool):
    """Return the leakage coefficient [m3/s/sqrt(Pa)] of every edge at a spool position [A]."""
    if p.null_leak == 0.0:
        return 0.0
    distance = abs(spool) / p.null_width
    if p.null_hyperbolic == 1.0:
        return p.null_leak / (1.0 + distance)
    return p.null_leak * math.exp(-distance * distance)


@njit
def orifice_flow(coefficient, drop):
    """Flow [m3/s] with sqrt(|drop|) and the drop's sign, laminar below `TRANSITION_DROP`."""
    return coefficient * drop / math.sqrt(math.sqrt(drop * drop + TRANSITION_DROP * TRANSITION_DROP))


@njit
def edge_flows(p, spool, gain, pressure_a, pressure_b, supply, tank):
    """Flows [m3/s] supply -> A, A -> tank, supply -> B, B -> tank at the spool's position [A]."""
    leak, out, back = null_leak(p, spool), p.gain_positive * p.orifice, p.gain_negative * p.orifice

    def flow(k, size, travel, overlap, drop):
        conductance = gain * size * opening(p, travel, overlap + p.edge_overlap[k]) + leak
        return orifice_flow(p.edge_ratio[k] * conductance, drop)

    return (
        flow(0, out, spool, p.overlap_positive, supply - pressure_a),
        flow(1, back, -spool, p.overlap_negative, pressure_a - tank),
        flow(2, back, -spool, p.overlap_negative, supply - pressure_b),
        flow(3, out, spool, p.overlap_positive, pressure_b - tank),
    )


ROUNDING_VELOCITY = 1e-3  # m/s, over which the smooth form turns the sign


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
    """Return the bristles' deflection z [m] after a substep, exact at constant velocity."""
    if level <= 0.0:
        return 0.0
    decay = p.bristle_stiffness * abs(velocity) / level
    if decay * SUBSTEP_TIME < 1e-9:
        return bristle + SUBSTEP_TIME * velocity
    steady = level / p.bristle_stiffness * (1.0 if velocity > 0.0 else -1.0)
    return steady + (bristle - steady) * math.exp(-decay * SUBSTEP_TIME)


@njit
def dry_friction(p, velocity, bristle, level, other_force):
    """Force [N] on the mass, against motion; `other_force` [N] sums all others, which sticking must balance."""
    if level <= 0.0:
        return 0.0
    if p.friction_form == LUGRE_FRICTION:
        slip = velocity - p.bristle_stiffness * abs(velocity) / level * bristle
        return -p.bristle_stiffness * bristle - p.bristle_damping * slip * math.exp(-((velocity / 0.01) ** 2))
    if p.friction_form == SMOOTH_FRICTION:
        return -level * velocity / math.sqrt(velocity * velocity + ROUNDING_VELOCITY * ROUNDING_VELOCITY)
    # static: the force that brings the mass to rest within the substep, limited to friction's level
    holding = -(p.mass * velocity / SUBSTEP_TIME + other_force)
    return min(max(holding, -level), level)


RELIEF_SLOPE = 1e-9  # m3/s/Pa, of a pump's relief valve

STOP_STIFFNESS = 2e7  # N/m, metal on metal
STOP_DAMPING = 2e3  # N s/m


@njit
def drag_spring_end(p, position, spring_end):
    """Return the spring's end [m] after the piston moved to `position` [m], with play."""
    return min(max(spring_end, position - 0.5 * p.backlash), position + 0.5 * p.backlash)


@njit
def load_force(p, position, spring_end, hysteresis):
    """Force [N] between mass and load, positive when it resists extension.

    `spring_end`: place [m] of the spring's driven end with play. `hysteresis`: state of the Bouc-Wen element.
    """
    deflection = position - p.rest
    if p.backlash > 0.0 and p.backlash_play == 1.0:
        deflection = spring_end - p.rest
    elif p.backlash > 0.0:
        deflection -= min(max(deflection, -0.5 * p.backlash), 0.5 * p.backlash)
    return (p.stiffness + p.hardening * deflection * deflection) * deflection + p.hysteresis_force * hysteresis


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


STANDSTILL_VELOCITY = 1e-5  # m/s, below which a direction of motion says nothing

CONTENT_A, CONTENT_B, POSITION, VELOCITY, SPOOL, SPOOL_RATE, SUPPLY, HYSTERESIS, RETURN = range(9)

TRUTH_STATE_DTYPE = np.dtype(
    [
        ("y", np.float64, (9,)),  # the integrated state, in the order above
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
        ("draw", np.float64),  # m3/s, flow from the supply into the valve
        ("commands", np.float64, (DELAY_SAMPLES,)),  # A, ring of past commands
        ("sample", np.int64),
    ]
)
"""State of the physical plant."""


@njit
def rest_state(p, state):
    """Put the bench at rest: spring relaxed, no current, pressures at which small motions in both directions settle."""
    ratio = p.area_b / p.area_a
    state.y[:] = 0.0
    state.y[POSITION] = state.spring_end = p.rest
    state.y[SPOOL] = p.valve_offset
    state.y[SUPPLY], state.y[RETURN] = p.source_pressure, p.tank_pressure
    drop = p.source_pressure - p.tank_pressure
    state.pressure_b = p.tank_pressure + 0.5 * drop * (1.0 + ratio**2) / (1.0 + ratio**3)
    state.pressure_a = ratio * state.pressure_b
    state.y[CONTENT_A] = content_of(p, state.pressure_a, p.dead_volume_a + p.area_a * p.rest)
    state.y[CONTENT_B] = content_of(p, state.pressure_b, p.dead_volume_b + p.area_b * (p.stroke - p.rest))
    state.bristle = state.walk = 0.0
    state.commands[:] = 0.0
    state.sample = 0
    _settle(p, state)
    state.hydraulic_force_rate = state.load_force_rate = state.friction_force = state.draw = 0.0


@njit
def _settle(p, state):
    y = state.y
    state.pressure_a = pressure_of(p, y[CONTENT_A], p.dead_volume_a + p.area_a * y[POSITION], state.pressure_a)
    volume_b = p.dead_volume_b + p.area_b * (p.stroke - y[POSITION])
    state.pressure_b = pressure_of(p, y[CONTENT_B], volume_b, state.pressure_b)
    state.hydraulic_force = p.area_a * state.pressure_a - p.area_b * state.pressure_b
    state.load_force = load_force(p, y[POSITION], state.spring_end, y[HYSTERESIS])


@njit
def _derivative(p, state, y, pressure_a, pressure_b, time, command, slope):
    """Slope of y at pressures that belong to y; leaves friction force and draw in `state`."""
    spool = y[SPOOL] if p.spool_order > 0.0 else command + p.valve_offset
    supply = y[SUPPLY]
    if p.ripple_amplitude > 0.0:
        supply += p.ripple_amplitude * math.sin(2.0 * math.pi * p.ripple_frequency * time)
    warming = 0.0 if p.warm_change == 0.0 else p.warm_change * (1.0 - math.exp(-time / p.warm_time))
    gain = max((1.0 + p.gain_drift * time) * (1.0 + warming), 0.0)
    into_a, out_of_a, into_b, out_of_b = edge_flows(p, spool, gain, pressure_a, pressure_b, supply, y[RETURN])
    drop = pressure_a - pressure_b
    across = p.leak_internal * drop + orifice_flow(p.leak_internal_orifice, drop)  # past the piston's seal
    lost_a = p.leak_external_a * (pressure_a - p.tank_pressure)
    lost_b = p.leak_external_b * (pressure_b - p.tank_pressure)
    state.draw = into_a + into_b
    slope[CONTENT_A] = (into_a - out_of_a - across - lost_a) / specific_volume(p, pressure_a)[0]
    slope[CONTENT_B] = (into_b - out_of_b + across - lost_b) / specific_volume(p, pressure_b)[0]
    slope[SPOOL] = slope[SPOOL_RATE] = 0.0  # of an ideal spool
    ahead = command + p.valve_offset - y[SPOOL]
    if p.spool_order == 2.0:
        pull = p.spool_frequency * ahead - 2.0 * p.spool_damping * y[SPOOL_RATE]
        slope[SPOOL] = min(max(y[SPOOL_RATE], -p.spool_rate_limit), p.spool_rate_limit)
        slope[SPOOL_RATE] = p.spool_frequency * pull
    elif p.spool_order == 1.0:
        slope[SPOOL] = min(max(p.spool_frequency * ahead, -p.spool_rate_limit), p.spool_rate_limit)
    slope[SUPPLY] = (p.source_pressure - p.droop_resistance * state.draw - y[SUPPLY]) / p.droop_time
    if p.pump_flow < NEVER_REACHED:
        lost = RELIEF_SLOPE * max(y[SUPPLY] - p.source_pressure, 0.0) + p.pump_leakage * y[SUPPLY]
        slope[SUPPLY] = p.bulk_modulus / p.pump_volume * (p.pump_flow - state.draw - lost)
    slope[RETURN] = (p.tank_pressure + p.line_resistance * (out_of_a + out_of_b) - y[RETURN]) / p.line_time
    if p.line_orifice > 0.0:
        volume_over_modulus = p.line_time * p.line_orifice / (2.0 * math.sqrt(5e5))
        passed = orifice_flow(p.line_orifice, y[RETURN] - p.tank_pressure)
        slope[RETURN] = (out_of_a + out_of_b - passed) / volume_over_modulus
    slope[HYSTERESIS] = 0.0
    if p.hysteresis_force != 0.0:  # Bouc-Wen
        size, velocity = abs(y[HYSTERESIS]) ** p.hysteresis_exponent, y[VELOCITY]
        toward = 1.0 if y[HYSTERESIS] >= 0.0 else -1.0
        bent = velocity - 0.5 * (abs(velocity) * toward + velocity) * size
        slope[HYSTERESIS] = bent / p.hysteresis_deflection
    slope[POSITION] = y[VELOCITY]
    slope[VELOCITY] = _acceleration(p, state, y, pressure_a, pressure_b, time)


@njit
def _acceleration(p, state, y, pressure_a, pressure_b, time):
    position, velocity = y[POSITION], y[VELOCITY]
    force = p.area_a * pressure_a - p.area_b * pressure_b - p.viscous * velocity
    outside = p.force_offset + p.walk_force * state.walk
    if p.hum_amplitude > 0.0:
        outside += p.hum_amplitude * math.sin(2.0 * math.pi * p.hum_frequency * time)
    force += end_force(p, position, velocity) + outside
    force -= load_force(p, position, drag_spring_end(p, position, state.spring_end), y[HYSTERESIS])
    # at standstill friction opposes where the other forces would move the mass, with the level of that direction
    sticks = p.friction_form != LUGRE_FRICTION and abs(velocity) < STANDSTILL_VELOCITY
    heading = math.copysign(STANDSTILL_VELOCITY, force) if sticks else velocity
    level = friction_level(p, heading, position, pressure_a - pressure_b)
    dry = dry_friction(p, velocity, state.bristle, level, force)
    state.friction_force = p.viscous * velocity - dry
    return (force + dry) / p.mass


@njit
def hold_command(p, state, current, walk_noise):
    """Begin a sample: store its valve current [A] and draw the random force's next value."""
    state.commands[state.sample % DELAY_SAMPLES] = current
    if p.oil_drift != 0.0:  # at once, at equal pressures: the content is the volume at zero pressure
        p.bulk_modulus = p.bulk_modulus_at_start * (1.0 + p.oil_drift * state.sample * SAMPLE_PERIOD)
        position = state.y[POSITION]
        state.y[CONTENT_A] = content_of(p, state.pressure_a, p.dead_volume_a + p.area_a * position)
        state.y[CONTENT_B] = content_of(p, state.pressure_b, p.dead_volume_b + p.area_b * (p.stroke - position))
    if p.walk_force > 0.0:
        kept = math.exp(-SAMPLE_PERIOD / p.walk_time)
        state.walk = kept * state.walk + math.sqrt(1.0 - kept * kept) * walk_noise


@njit
def advance_substep(p, state, index, work):
    """Advance by substep `index` of the present sample by Heun's method, in place; `work`: scratch, shape (3, 9)."""
    elapsed = index * SUBSTEP_TIME
    time = state.sample * SAMPLE_PERIOD + elapsed
    # the command is constant within a step; both of Heun's slopes must see the same side of its jumps
    late = math.floor((elapsed - p.delay) / SAMPLE_PERIOD + 1e-9)  # the margin keeps multiples of the sample exact
    command = state.commands[(state.sample + int(late)) % DELAY_SAMPLES]
    force_h, force_l = state.hydraulic_force, state.load_force
    y, guess, slope, slope_ahead = state.y, work[0], work[1], work[2]
    if p.friction_form == LUGRE_FRICTION:
        level = friction_level(p, y[VELOCITY], y[POSITION], state.pressure_a - state.pressure_b)
        state.bristle = advance_bristle(p, state.bristle, y[VELOCITY], level)  # lives half a step ahead of y
    _derivative(p, state, y, state.pressure_a, state.pressure_b, time, command, slope)
    for i in range(9):
        guess[i] = y[i] + SUBSTEP_TIME * slope[i]
    volume_a = p.dead_volume_a + p.area_a * guess[POSITION]
    volume_b = p.dead_volume_b + p.area_b * (p.stroke - guess[POSITION])
    pressure_a = pressure_of(p, guess[CONTENT_A], volume_a, state.pressure_a)
    pressure_b = pressure_of(p, guess[CONTENT_B], volume_b, state.pressure_b)
    _derivative(p, state, guess, pressure_a, pressure_b, time + SUBSTEP_TIME, command, slope_ahead)
    for i in range(9):
        y[i] += 0.5 * SUBSTEP_TIME * (slope[i] + slope_ahead[i])
    y[SPOOL_RATE] = min(max(y[SPOOL_RATE], -p.spool_rate_limit), p.spool_rate_limit)
    if p.spool_order == 0.0:
        y[SPOOL] = command + p.valve_offset
    state.spring_end = drag_spring_end(p, y[POSITION], state.spring_end)
    _settle(p, state)
    state.hydraulic_force_rate = (state.hydraulic_force - force_h) / SUBSTEP_TIME
    state.load_force_rate = (state.load_force - force_l) / SUBSTEP_TIME
    if index == SUBSTEPS - 1:
        state.sample += 1
