# SPDX-License-Identifier: Apache-2.0
"""Observer of the structured model's state from the readings so far (an extended Kalman filter).

A window cannot start from the measurement itself: its 0.6 N and 6 kPa of noise would be most of the error 70 samples
later, and the spool, the bristle and the amplifier are not measured at all. The filter uses the five readings (the
rates are made from them and hold nothing new), their noise, and the model; it looks only back. Its Jacobian is taken by
finite differences.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from hydro_bridge.signals import FloatArray
from hydro_sim import copies
from hydro_sim.jit import njit
from hydro_sim.structured import integration, rollout
from hydro_sim.structured.integration import STATES
from hydro_sim.structured.rollout import INPUTS, OUTPUTS, READINGS

SETTLING = 500
"""Samples after which a filter that began from a measurement has settled."""

NUDGES: FloatArray = np.array([1e3, 1e3, 1e-7, 1e-5, 1e-6, 1e-3, 1e-2, 1.0, 1e-8])
"""Steps of the finite differences, units of the state."""

SPREAD: FloatArray = np.array([2e4, 2e4, 2e-6, 2e-3, 2e-3, 1.0, 2.0, 200.0, 1e-5])
"""Standard deviation of the first guess, units of the state."""


READING_NOISE: FloatArray = np.array([0.6, 0.6, 6e3, 6e3, 3e-7])
"""Standard deviation of f_h, f_l [N], p_a, p_b [Pa], x_p [m] in one sample (physics.md; 1 um / sqrt(12) for
x_p).
"""

MISSED: FloatArray = np.array([100.0, 100.0, 0.0, 2e-5, 1e-7, 0.0, 0.0, 0.0, 1e-9])
"""Standard deviation per sample of the model's own error at scale 1, units of the state."""


def constants(trust: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Settings of the compiled filter: spread, nudges, what the model misses at that scale, the readings' noise."""
    return SPREAD, NUDGES, trust * MISSED, READING_NOISE


@njit
def _reading_matrix(c):
    """Readings as row @ s + bias: shapes (5, 9) and (5,)."""
    row, bias, unit, reading = np.empty((READINGS, STATES)), np.empty(READINGS), np.zeros(STATES), np.empty(READINGS)
    rollout.read(c, unit, bias)
    for i in range(STATES):
        unit[:] = 0.0
        unit[i] = 1.0
        rollout.read(c, unit, reading)
        for j in range(READINGS):
            row[j, i] = reading[j] - bias[j]
    return row, bias


@njit
def _correct(s, p, row, bias, reading, noise):
    """Take in five readings, one after the other: their noises are independent."""
    for j in range(READINGS):
        ph = p @ row[j]
        gain = ph / (row[j] @ ph + noise[j] * noise[j])
        s += gain * (reading[j] - bias[j] - row[j] @ s)
        p -= np.outer(gain, ph)


@njit
def follow(model, readings, currents, start, settings, states):
    """Filter one run: `states`, shape (n, 12), become the full states at the samples of `readings`, shape (n, 5).

    `start`, shape (12,), is the first guess. The rates are made of the model's own steps, not of the differences
    between one corrected estimate and the next: these are noise.
    """
    c, layers, center, scale, memories = model
    spread, nudges, missed, noise = settings
    work, full, moved = integration.scratch(), start.copy(), np.empty(STATES)
    x, r, measured = np.empty(INPUTS), np.empty(OUTPUTS), np.empty(8)
    a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    s, p, jacobian = full[:STATES], np.diag(spread * spread), np.empty((STATES, STATES))
    row, bias = _reading_matrix(c)
    for k in range(len(readings)):
        if k > 0:
            current = currents[k - 1]
            for i in range(STATES):
                copies.vector(moved, s)
                moved[i] += nudges[i]
                rollout.advance(c, layers, center, scale, moved, current, work, x, a1, a2, r)
                copies.vector(jacobian[:, i], moved)
            rollout.advance_full(c, layers, center, scale, memories, full, current, work, x, a1, a2, r, measured)
            for j in range(STATES):
                for i in range(STATES):
                    jacobian[j, i] = (jacobian[j, i] - s[j]) / nudges[i]
            p = jacobian @ p @ jacobian.T
            for i in range(STATES):
                p[i, i] += missed[i] * missed[i]
            p = 0.5 * (p + p.T)
        _correct(s, p, row, bias, readings[k], noise)
        rollout.bound(c, s)
        copies.vector(states[k], full)


@njit(parallel=True)
def follow_chunks(
    c, layers, center, scale, memories, readings, currents, starts, spread, nudges, missed, noise, begins, ends, states
):
    """Filter samples begins[i]:ends[i], each chunk from its own first guess starts[i], into states[i]."""
    for i in prange(len(begins)):
        b, e = begins[i], ends[i]
        follow(
            (c, layers, center, scale, memories), readings[b:e], currents[b:e], starts[i],
            (spread, nudges, missed, noise), states[i, : e - b],
        )  # fmt: skip
