# SPDX-License-Identifier: Apache-2.0
"""States of a bench file's model at each sample, compiled: measured where there is a sensor, simulated elsewhere.

    measured    p_a  p_b  x_p  x_p'  f_l  f_l'    from the readings
    simulated   all other states of the model     open loop, from the measured ones and the current that the valve got;
                                                  they forget their initial values as fast as their effects do
    observed    p_a or p_b behind a lagging       by the model's step, corrected by the position and what its
                sensor, and that sensor           sensor shows (`terms.pressure_observer`)

The valve is read from the model's rates: g is the slope of f_h' from the closed valve to where the spool is. A valve
without a lag has the last current for its spool, or the one whose dead time ends. Currents within their dead time are
states of the model, and known.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD
from hydro_filter.model.parts import NONE
from hydro_filter.model.sample import (
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
)
from hydro_sim.jit import copy_vector, njit
from hydro_sim.model import machine_code

PROBE = 0.1
"""m/s, over which the velocity's part of the flows is taken; they are linear in it."""


@njit
def model_state(p, hidden, x, y, cell):
    """Write the full model's state y from simulated states and a measurement; `cell`: also f_l and its rate.

    `y` may be `hidden`.
    """
    predicted = hidden[0], hidden[1], hidden[2]
    for i in range(len(y)):
        y[i] = hidden[i]
    y[0] = (x[PRESSURE_A] - p.bias[2]) / p.gain[2]
    y[1] = (x[PRESSURE_B] - p.bias[3]) / p.gain[3]
    y[2], y[3] = (x[POSITION] - p.bias[4]) / p.gain[4], x[VELOCITY] / p.gain[4]
    if len(p.lagging) > 0:
        observe(p, predicted, y)
    if cell:
        y[p.cell] = (x[LOAD_FORCE] - p.bias[1]) / p.gain[1]
        if p.cell_rate != NONE:
            y[p.cell_rate] = x[LOAD_FORCE_RATE] / p.gain[1]


@njit
def observe(p, predicted, y):
    """Correct the pressures behind lagging sensors, and these sensors; y holds readings, `predicted`: p_a, p_b, x_p."""
    count, shown = len(p.lagging), (y[0], y[1])
    for i in range(count):
        y[p.lagging[i, 2]] = predicted[p.lagging[i, 2]]
    _correct(p, y, count, y[2] - predicted[2])
    errors = np.empty(count)
    for i in range(count):
        errors[i] = shown[p.lagging[i, 2]] - y[p.lagging[i, 0]]
    for i in range(count):
        _correct(p, y, i, errors[i])


@njit
def _correct(p, y, row, error):
    """Add a row of the observer's gains times an error."""
    for j in range(len(p.lagging)):
        y[p.lagging[j, 2]] += p.observer[row, 3 * j] * error
        y[p.lagging[j, 0]] += p.observer[row, 3 * j + 1] * error
        y[p.lagging[j, 1]] += p.observer[row, 3 * j + 2] * error


@njit
def set_opening(p, y, spool, spool_rate, opening):
    """Set a state's spool, and the currents on their way to it, to the opening [A]; returns the current for it."""
    for i in range(len(y) - p.past, len(y)):
        y[i] = opening - p.after - p.before
    if spool == NONE:
        return opening - p.after - p.before
    y[spool] = opening - p.after
    if spool_rate != NONE:
        y[spool_rate] = 0.0
    return opening - p.after - p.before


@njit
def held_rates(p, y, opening, whole, slopes):
    """Rates y' of the full or the loop's model with the valve held at `opening` [A]; returns f_h' [N/s]."""
    current = np.empty(1)
    if whole:
        current[0] = set_opening(p, y, p.spool, p.spool_rate, opening)
        machine_code.rates(p.rates_at, p.k, 1, y, current, slopes)
    else:
        current[0] = set_opening(p, y, p.loop_spool, p.loop_spool_rate, opening)
        machine_code.rates(p.loop_rates_at, p.loop_k, 1, y, current, slopes)
    return p.area * (slopes[0] - p.ratio * slopes[1])


@njit
def hydraulic_slopes(p, state, opening):
    """Sensitivities of f_h' of the loop's model at a state.

    g [N/s/A] on the opening's side, what f_h' loses per velocity [N/m], f_h' of the closed valve at rest [N/s], and how
    fast a velocity lowers p_a and raises p_b [Pa/m].
    """
    y, slopes = state.copy(), np.empty(p.slopes)
    side = math.copysign(1.0, opening)
    closed = held_rates(p, y, 0.0, False, slopes)
    rate_a, rate_b = slopes[0], slopes[1]
    y[3] += PROBE
    held_rates(p, y, 0.0, False, slopes)
    soft_a, soft_b = (rate_a - slopes[0]) / PROBE, (slopes[1] - rate_b) / PROBE
    y[3] -= PROBE
    size = max(abs(opening), p.least_opening)
    gain = (held_rates(p, y, side * size, False, slopes) - closed) / (side * size)
    stiffness = p.area * (soft_a + p.ratio * soft_b)
    return max(gain, p.least_gain), stiffness, closed + stiffness * y[3], soft_a, soft_b


@njit
def reset(memory):
    """Reset at the start or after a gap; `memory`: one record of `parts.MEMORY_DTYPE`."""
    memory.hidden[:] = 0.0
    memory.reference_rate, memory.running = 0.0, False


@njit
def settle(loop, memory, x, current, reference_rate):
    """Initialise from the first sample, with the spool in equilibrium with the present current."""
    if not memory.running:
        p, n = loop.model, len(loop.model.rest)
        memory.hidden[:] = 0.0
        copy_vector(memory.hidden, p.rest)
        for i in range(len(p.lagging)):
            chamber = p.lagging[i, 2]
            shown = (x[PRESSURE_A + chamber] - p.bias[2 + chamber]) / p.gain[2 + chamber]
            memory.hidden[chamber] = memory.hidden[p.lagging[i, 0]] = shown
        model_state(p, memory.hidden, x, memory.hidden[:n], True)
        memory.hidden[n] = current + p.before + p.after
        set_opening(p, memory.hidden, p.spool, p.spool_rate, memory.hidden[n])
        memory.reference_rate, memory.current, memory.running = reference_rate, current, True


@njit
def follow(loop, memory, x, current, reference_rate):
    """Advance the memory by one sample, during which the valve holds `current` [A]."""
    p, n, z = loop.model, len(loop.model.rest), np.empty(5)
    opening = memory.hidden[n]
    model_state(p, memory.hidden, x, memory.hidden[:n], False)
    machine_code.sample(p.sample_at, p.sample_k, memory.hidden, current, z)
    arrived = current if p.past == 0 else memory.hidden[n - p.past + p.at_valve]
    memory.hidden[n] = (arrived + p.before if p.spool == NONE else memory.hidden[p.spool]) + p.after
    own_rate = p.spool != NONE and p.spool_rate != NONE
    memory.hidden[n + 1] = memory.hidden[p.spool_rate] if own_rate else (memory.hidden[n] - opening) / SAMPLE_PERIOD
    memory.reference_rate, memory.current = reference_rate, current
