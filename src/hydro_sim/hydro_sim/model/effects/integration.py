# SPDX-License-Identifier: Apache-2.0
"""One sample of the bench with its effects: what `hydro_sim.model.hydraulics.advance` is for a bench without. Compiled.

The state is that of `model.hydraulics` and, behind it, the supply's lagged demand. Valve edges are held over a
Runge-Kutta step at their mean; bristles, the load's gap and amplifiers move on where a step ends.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.model import hydraulics
from hydro_sim.model.effects import motion, oil, sensing, valve
from hydro_sim.model.effects.record import SUBSTEPS
from hydro_sim.model.hydraulics import LOAD_CELL_DAMPING

STATES = hydraulics.STATES + 1
DEMAND = hydraulics.STATES
"""Where the lagged demand [m3/s] stands in the state."""

NO_GRIP = (0.0, np.nan)
"""See `hydro_sim.model.effects.motion.grip`."""


@njit(cache=True)
def begin(bench, memory, y, raw):
    """Empty the memory: no current has flowed, amplifiers show `raw`, shape (5,), which is made into readings."""
    memory.samples, memory.demand = 0, 0.0
    valve.begin(bench.effects, memory)
    motion.begin(memory, y[2])
    sensing.begin(bench.effects, memory, raw)
    sensing.show(bench.effects, memory, raw)


@njit(cache=True)
def advance(bench, memory, y, current):
    """Hold a current [A] for one sample: y, shape (6,), of `model.hydraulics`, and `memory` move on in place."""
    program = bench.effects
    step = SAMPLE_PERIOD / SUBSTEPS
    state, slopes, probe, raw = np.empty(STATES), np.empty((4, STATES)), np.empty(STATES), np.empty(5)
    state[:DEMAND], state[DEMAND] = y, memory.demand
    valve.hold(program, memory, current)
    for k in range(SUBSTEPS):
        spool = valve.command(program, memory, k)
        time = memory.samples * SAMPLE_PERIOD + (k + 0.5) * step
        out, back = valve.openings(program, bench.valve_gain, spool, time)
        _runge_kutta(bench, memory, state, out, back, step, slopes, probe)
        motion.remember(program, memory, state[2], state[3])
        if bench.load_cell_omega == 0.0:
            state[4] = motion.load(program, bench, memory, state[2])
        read(bench, state, raw)
        sensing.follow(program, memory, raw)
    memory.samples += 1
    y[:], memory.demand = state[:DEMAND], state[DEMAND]


@njit(cache=True)
def read(bench, y, raw):
    """True values of the five sensors, in the order of `hydro_sim.model.sensors.RAW_FIELDS`."""
    raw[0] = hydraulics.hydraulic_force(bench, y[0], y[1])
    raw[1], raw[2], raw[3], raw[4] = y[4], y[0], y[1], y[2]


@njit(cache=True)
def _runge_kutta(bench, memory, state, out, back, step, slopes, probe):
    program = bench.effects
    rates(bench, memory, state, out, back, NO_GRIP, slopes[0])
    gripped = motion.grip(program, bench.moving_mass, state[3], slopes[0, 3], step)
    slopes[0, 3] -= motion.dry(program, gripped, state[3]) / bench.moving_mass
    for stage in range(1, 4):
        reach = step if stage == 3 else 0.5 * step
        for i in range(STATES):
            probe[i] = state[i] + reach * slopes[stage - 1, i]
        rates(bench, memory, probe, out, back, gripped, slopes[stage])
    for i in range(STATES):
        state[i] += step / 6.0 * (slopes[0, i] + 2.0 * slopes[1, i] + 2.0 * slopes[2, i] + slopes[3, i])
    state[0], state[1] = max(state[0], 0.0), max(state[1], 0.0)
    if not np.isnan(gripped[1]):
        state[3] = 0.0


@njit(cache=True)
def rates(bench, memory, y, out, back, gripped, slope):
    """Write y', shape (7,), into `slope`.

    Edges are open by `out` and `back` [m3/s/sqrt(Pa)], dry friction does what `model.effects.motion.grip` found.
    """
    program, tank = bench.effects, bench.tank_pressure
    supply = bench.supply_pressure - oil.sag(program, y[DEMAND])
    drawn_a, drawn_b = _through(out, supply - y[0]), _through(back, supply - y[1])
    from_a, from_b = oil.leaks(program, y[0], y[1], tank)
    into_a = drawn_a - _through(back, y[0] - tank) - from_a
    into_b = drawn_b - _through(out, y[1] - tank) - from_b
    volume_a, volume_b = hydraulics.volumes(bench, y[2])
    swept = bench.piston_area * y[3]
    slope[0] = oil.stiffness(program, bench.bulk_modulus, y[0]) / volume_a * (into_a - swept)
    slope[1] = oil.stiffness(program, bench.bulk_modulus, y[1]) / volume_b * (into_b + bench.area_ratio * swept)

    force = motion.load(program, bench, memory, y[2])
    against = bench.viscous_friction * y[3] + motion.resistance(program, memory, y[2], y[3])
    against += motion.dry(program, gripped, y[3])
    driven = hydraulics.hydraulic_force(bench, y[0], y[1]) - hydraulics.stop_force(bench, y[2], y[3])
    slope[2] = y[3]
    slope[3] = (driven - against - force) / bench.moving_mass
    omega = bench.load_cell_omega
    slope[4] = y[5]
    slope[5] = omega * (omega * (force - y[4]) - 2.0 * LOAD_CELL_DAMPING * y[5])
    slope[DEMAND] = oil.demand_rate(program, drawn_a + drawn_b, y[DEMAND])


@njit(cache=True)
def _through(opening, drop):
    """Flow [m3/s] through an edge at a pressure drop [Pa]."""
    return opening * hydraulics.signed_sqrt(drop) if opening > 0.0 else 0.0
