# SPDX-License-Identifier: Apache-2.0
"""Displacement v of the loop's state from its reference trajectory.

The paper projects v on the force error (eq. v), so that the certificate cannot represent the instability at high gains.
Here v = (q - q_r) / scale over all loop coordinates (`loop_model`), with q_r from f_r, f_r', f_r'' and the learned
model (w, d: the load cell's frequency and damping)::

    spring force  F = f_r + 2 d/w f_r' + f_r''/w^2     x_p = x_rest + F/k_s    x_p' = F'/k_s    f_l, f_l' = f_r, f_r'
    f_h = F + m F''/k_s + b x_p' + friction             spool: what holds f_h' = F' at that velocity

Spool and bristle are not measured: `MEMORY_DTYPE` simulates both from measured signals, the valve's currents and the
piston's velocity. The present friction is used, so that it causes no displacement.
"""

from __future__ import annotations

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.model import hidden_states
from hydro_filter.model.hidden_states import BRISTLE_STATE, HIDDEN, SPOOL, SPOOL_RATE
from hydro_filter.model.loop_model import (
    LOOP,
    Q_BOX_VELOCITY,
    Q_HYDRAULIC,
    Q_LOAD,
    Q_LOAD_RATE,
    Q_POSITION,
    Q_SPOOL,
    Q_SPOOL_RATE,
    Q_VELOCITY,
    hydraulic_slopes,
)
from hydro_filter.model.state import (
    HYDRAULIC_FORCE,
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    POSITION,
    PRESSURE_A,
    PRESSURE_B,
    VELOCITY,
)
from hydro_sim.jit import njit
from hydro_sim.structured import physics
from hydro_sim.structured.physics import (
    BIAS_H,
    BIAS_L,
    CELL_DAMPING,
    CELL_OMEGA,
    GAIN_H,
    GAIN_L,
    MASS,
    REST,
    SPRING,
    VISCOUS,
)  # fmt: skip

MEMORY_DTYPE = np.dtype(
    [("hidden", np.float64, (HIDDEN,)), ("reference_rate", np.float64), ("running", np.bool_)], align=True
)
"""What is remembered of one bench: spool [A], its rate [A/s], bristle [m]; the last f_r' [N/s]; whether it ran."""

BEND_MAX = 2e5
"""N/s^2, limit of f_r'': 300 N at 4 Hz; that of a switched reference is arbitrary."""


@njit
def reset(memory):
    """Reset at the start or after a gap; `memory`: one record of `MEMORY_DTYPE`."""
    memory.hidden[:] = 0.0
    memory.reference_rate, memory.running = 0.0, False


@njit(inline="always")
def settle(loop, memory, x, current, reference_rate):
    """Initialise from the first sample, with hidden states in equilibrium."""
    if not memory.running:
        hidden_states.steady(loop.model[0], x[VELOCITY], current, memory.hidden)
        memory.reference_rate, memory.running = reference_rate, True


@njit(inline="always")
def follow(loop, memory, x, current, reference_rate):
    """Advance the memory by one sample, during which the valve holds `current` [A]."""
    hidden_states.follow(loop.model[0], x[VELOCITY], current, memory.hidden)
    memory.reference_rate = reference_rate


@njit
def second_derivative(memory, reference_rate):
    """Return f_r'' [N/s^2] from two samples of f_r'."""
    return min(max((reference_rate - memory.reference_rate) / SAMPLE_PERIOD, -BEND_MAX), BEND_MAX)


@njit(inline="always")
def displace(loop, memory, x, reference, reference_rate, v):
    """Write v, shape (8,), of a sample x, shape (8,), at f_r [N] and f_r' [N/s]."""
    c, bent, hidden = loop.model[0], second_derivative(memory, reference_rate), memory.hidden
    lag, inertia = 2.0 * c[CELL_DAMPING] / c[CELL_OMEGA], 1.0 / c[CELL_OMEGA] ** 2
    spring = (reference - c[BIAS_L] + lag * reference_rate + inertia * bent) / c[GAIN_L]
    spring_rate, spring_bend = (reference_rate + lag * bent) / c[GAIN_L], bent / c[GAIN_L]
    velocity = spring_rate / c[SPRING]
    dry = physics.friction(c, x[VELOCITY], hidden[BRISTLE_STATE])
    hydraulic = spring + (c[MASS] * spring_bend + c[VISCOUS] * spring_rate) / c[SPRING] + dry
    gain, stiffness = hydraulic_slopes(c, x[PRESSURE_A], x[PRESSURE_B], x[POSITION], hidden[SPOOL])
    v[Q_HYDRAULIC] = x[HYDRAULIC_FORCE] - c[BIAS_H] - c[GAIN_H] * hydraulic
    v[Q_SPOOL] = hidden[SPOOL] - (spring_rate + stiffness * velocity) / gain
    v[Q_SPOOL_RATE] = hidden[SPOOL_RATE] - (1.0 + stiffness / c[SPRING]) * spring_bend / gain
    v[Q_LOAD] = x[LOAD_FORCE] - reference
    v[Q_LOAD_RATE] = x[LOAD_FORCE_RATE] - reference_rate
    v[Q_POSITION] = x[POSITION] - c[REST] - spring / c[SPRING]
    v[Q_VELOCITY] = v[Q_BOX_VELOCITY] = x[VELOCITY] - velocity
    for i in range(LOOP):
        v[i] /= loop.scale[i]
    v[Q_SPOOL] *= gain
    v[Q_SPOOL_RATE] *= gain
