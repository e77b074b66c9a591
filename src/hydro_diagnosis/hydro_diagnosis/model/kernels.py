# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of the chamber equations and of the forward simulation: one pass over arrays of shape (n,).

Along a record n is in the ten thousands and memory traffic counts, in a simulation some hundred and each call's
overhead does: so results are written into arrays that are passed. The equations are those of `chambers` and
`simulation`, which call these where no effect changes them.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True)
def _root(drop):
    return np.copysign(np.sqrt(abs(drop)), drop)


@njit(cache=True)
def edge_flows(into_a, into_b, supply_a, a_tank, supply_b, b_tank, p_a, p_b, supply, tank):
    """Write the flows [m3/s] through the edges into both chambers; `tank` [Pa] is a number, all else (n,)."""
    for k in range(len(p_a)):
        into_a[k] = supply_a[k] * _root(supply[k] - p_a[k]) - a_tank[k] * _root(p_a[k] - tank)
        into_b[k] = supply_b[k] * _root(supply[k] - p_b[k]) - b_tank[k] * _root(p_b[k] - tank)


@njit(cache=True)
def nominal_flows(into_a, into_b, gain, spool, p_a, p_b, supply, tank):
    """The same of a zero-lapped valve; `spool` [A] has shape (n, substeps), `gain`, `supply` and `tank` are numbers."""
    share = gain / spool.shape[1]
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * share
            negative -= min(spool[k, s], 0.0) * share
        a, b = 0.0, 0.0
        if positive != 0.0:
            a += positive * _root(supply - p_a[k])
            b -= positive * _root(p_b[k] - tank)
        if negative != 0.0:
            a -= negative * _root(p_a[k] - tank)
            b += negative * _root(supply - p_b[k])
        into_a[k], into_b[k] = a, b


@njit(cache=True)
def first_moments(gain, moment, spool, p_a, p_b, supply, tank):
    """Sums over the substeps of `moment` (substeps,) times the flow [m3/s] into chamber A and into chamber B."""
    into_a, into_b = np.zeros_like(p_a), np.zeros_like(p_b)
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * moment[s]
            negative -= min(spool[k, s], 0.0) * moment[s]
        if positive != 0.0:
            into_a[k] += gain * positive * _root(supply - p_a[k])
            into_b[k] -= gain * positive * _root(p_b[k] - tank)
        if negative != 0.0:
            into_a[k] -= gain * negative * _root(p_a[k] - tank)
            into_b[k] += gain * negative * _root(supply - p_b[k])
    return into_a, into_b


@njit(cache=True)
def innovations(recorded, built, gain):
    """What a recorded signal has beyond the sum of what each sample has `built`, minus its slow part, shape (n,).

    The slow part follows by `gain` per sample; it begins at the mean of the first ten.
    """
    beyond = np.empty_like(recorded)
    total = 0.0
    for k in range(len(recorded)):
        beyond[k] = recorded[k] - total
        total += built[k]
    slow = beyond[:10].mean()
    for k in range(len(recorded)):
        now = beyond[k]
        beyond[k] = now - slow
        slow += gain * (now - slow)
    return beyond


@njit(cache=True)
def derivatives(rates, state, flows_a, flows_b, stiff_a, stiff_b, against, load, area, ratio, viscous, mass):
    """Write d/dt of [x_p, x_p', p_a, p_b], shape (4, n); `load` and what is `against` the motion in N, shape (n,)."""
    for k in range(state.shape[1]):
        v = state[1, k]
        driven = area * (state[2, k] - ratio * state[3, k]) - viscous * v - against[k] - load[k]
        rates[0, k] = v
        rates[1, k] = driven / mass
        rates[2, k] = stiff_a[k] * (flows_a[k] - area * v)
        rates[3, k] = stiff_b[k] * (flows_b[k] + ratio * area * v)


@njit(cache=True)
def runge_kutta(after, state, first, second, third, fourth, step):
    """Write the state after a step of the classical method, shape (4, n)."""
    for j in range(state.shape[0]):
        for k in range(state.shape[1]):
            slope = first[j, k] + 2.0 * second[j, k] + 2.0 * third[j, k] + fourth[j, k]
            after[j, k] = state[j, k] + step / 6.0 * slope


@njit(cache=True)
def _nominal(x, v, p_a, p_b, spool, bench):
    gain, supply, tank, beta, area, ratio, stroke, dead_a, dead_b, mass, viscous, spring, rest = bench
    opened, closed = gain * max(spool, 0.0), -gain * min(spool, 0.0)
    flow_a = opened * _root(supply - p_a) - closed * _root(p_a - tank)
    flow_b = closed * _root(supply - p_b) - opened * _root(p_b - tank)
    driven = area * (p_a - ratio * p_b) - viscous * v - spring * (x - rest)
    stiff_a = beta / (dead_a + area * x)
    stiff_b = beta / (dead_b + ratio * area * (stroke - x))
    return v, driven / mass, stiff_a * (flow_a - area * v), stiff_b * (flow_b + ratio * area * v)


@njit(cache=True)
def nominal_run(states, state, begins, spool, step, bench):
    """Write the states of windows of the bench without any effect, shape (length, 4, n), from `state`, shape (4, n).

    `begins`: first sample of each; `spool`: A, shape (samples, substeps), held for a substep of `step` [s]; `bench`:
    numbers, in the order of `_nominal`.
    """
    for k in range(len(begins)):
        x, v, p_a, p_b = state[0, k], state[1, k], state[2, k], state[3, k]
        for i in range(len(states)):
            states[i, 0, k], states[i, 1, k], states[i, 2, k], states[i, 3, k] = x, v, p_a, p_b
            for s in range(spool.shape[1]):
                u, half = spool[begins[k] + i, s], 0.5 * step
                a = _nominal(x, v, p_a, p_b, u, bench)
                b = _nominal(x + half * a[0], v + half * a[1], p_a + half * a[2], p_b + half * a[3], u, bench)
                c = _nominal(x + half * b[0], v + half * b[1], p_a + half * b[2], p_b + half * b[3], u, bench)
                d = _nominal(x + step * c[0], v + step * c[1], p_a + step * c[2], p_b + step * c[3], u, bench)
                x += step / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
                v += step / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
                p_a += step / 6.0 * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
                p_b += step / 6.0 * (a[3] + 2.0 * b[3] + 2.0 * c[3] + d[3])
