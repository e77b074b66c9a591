# SPDX-License-Identifier: Apache-2.0
"""Compiled inner loops of the chamber equations and of the forward simulation: one pass over arrays of shape (n,).

Along a record n is in the ten thousands and memory traffic counts, in a simulation some hundred and each call's
overhead does: so results are written into arrays that are passed. The equations are those of `chambers` and
`simulation`, which call these where no effect changes them; `bench` is a record of `model.bench.BENCH_DTYPE`.
"""

from __future__ import annotations

import numpy as np

from hydro_sim.jit import njit
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.model.hydraulics import pressure_rates


@njit
def edge_flows(into_a, into_b, supply_a, a_tank, supply_b, b_tank, p_a, p_b, supply, tank):
    """Write the flows [m3/s] through the edges into both chambers; `tank` [Pa] is a number, all else (n,)."""
    for k in range(len(p_a)):
        out, back = eq.edge_drops(supply[k], tank, p_a[k], p_b[k])
        into_a[k] = supply_a[k] * eq.signed_root(out[0]) - a_tank[k] * eq.signed_root(back[0])
        into_b[k] = supply_b[k] * eq.signed_root(back[1]) - b_tank[k] * eq.signed_root(out[1])


@njit
def _flows(positive, negative, p_a, p_b, supply, tank):
    """Flows into both chambers with all edges open [m3/s/sqrt(Pa)] that drive the piston out, and back."""
    out, back = eq.edge_drops(supply, tank, p_a, p_b)
    a, b = 0.0, 0.0
    if positive != 0.0:
        a += positive * eq.signed_root(out[0])
        b -= positive * eq.signed_root(out[1])
    if negative != 0.0:
        a -= negative * eq.signed_root(back[0])
        b += negative * eq.signed_root(back[1])
    return a, b


@njit
def nominal_flows(into_a, into_b, gain, spool, p_a, p_b, supply, tank):
    """The same of a zero-lapped valve; `spool` [A] has shape (n, substeps), `gain`, `supply` and `tank` are numbers."""
    share = gain / spool.shape[1]
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * share
            negative -= min(spool[k, s], 0.0) * share
        into_a[k], into_b[k] = _flows(positive, negative, p_a[k], p_b[k], supply, tank)


@njit
def first_moments(gain, moment, spool, p_a, p_b, supply, tank):
    """Sums over the substeps of `moment` (substeps,) times the flow [m3/s] into chamber A and into chamber B."""
    into_a, into_b = np.empty_like(p_a), np.empty_like(p_b)
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * moment[s]
            negative -= min(spool[k, s], 0.0) * moment[s]
        into_a[k], into_b[k] = _flows(gain * positive, gain * negative, p_a[k], p_b[k], supply, tank)
    return into_a, into_b


@njit
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


@njit
def fading_sums(built, keep):
    """Sum of what the earlier samples have `built`, of which each sample keeps that share: shape (terms, n).

    A sum minus its slow part, which follows by 1 - `keep` per sample from nothing, is this sum.
    """
    sums = np.empty_like(built)
    for j in range(len(built)):
        total = 0.0
        for k in range(built.shape[1]):
            sums[j, k] = total
            total = keep * total + built[j, k]
    return sums


@njit
def derivatives(rates, bench, state, flows_a, flows_b, stiff_a, stiff_b, against, load):
    """Write d/dt of [x_p, x_p', p_a, p_b], shape (4, n); `load` and what is `against` the motion in N, shape (n,)."""
    for k in range(state.shape[1]):
        v = state[1, k]
        driven = eq.hydraulic_force(bench, state[2, k], state[3, k])
        rates[0, k] = v
        rates[1, k] = (driven - bench.viscous_friction * v - against[k] - load[k]) / bench.moving_mass
        stiff, flows = (stiff_a[k], stiff_b[k]), (flows_a[k], flows_b[k])
        rates[2, k], rates[3, k] = eq.pressure_rates(bench, stiff, flows, v)


@njit
def runge_kutta(after, state, first, second, third, fourth, step):
    """Write the state after a step of the classical method, shape (4, n)."""
    for j in range(state.shape[0]):
        for k in range(state.shape[1]):
            slope = first[j, k] + 2.0 * second[j, k] + 2.0 * third[j, k] + fourth[j, k]
            after[j, k] = state[j, k] + step / 6.0 * slope


@njit
def _nominal(bench, x, v, p_a, p_b, current):
    rate_a, rate_b = pressure_rates(bench, p_a, p_b, x, v, current)
    driven = eq.hydraulic_force(bench, p_a, p_b) - bench.viscous_friction * v - eq.spring_force(bench, x)
    return v, driven / bench.moving_mass, rate_a, rate_b


@njit
def nominal_run(states, bench, state, begins, spool, step):
    """Write the states of windows of the bench without any effect, shape (length, 4, n), from `state`, shape (4, n).

    `begins`: first sample of each; `spool`: A, shape (samples, substeps), held for a substep of `step` [s].
    """
    for k in range(len(begins)):
        x, v, p_a, p_b = state[0, k], state[1, k], state[2, k], state[3, k]
        for i in range(len(states)):
            states[i, 0, k], states[i, 1, k], states[i, 2, k], states[i, 3, k] = x, v, p_a, p_b
            for s in range(spool.shape[1]):
                u, half = spool[begins[k] + i, s], 0.5 * step
                a = _nominal(bench, x, v, p_a, p_b, u)
                b = _nominal(bench, x + half * a[0], v + half * a[1], p_a + half * a[2], p_b + half * a[3], u)
                c = _nominal(bench, x + half * b[0], v + half * b[1], p_a + half * b[2], p_b + half * b[3], u)
                d = _nominal(bench, x + step * c[0], v + step * c[1], p_a + step * c[2], p_b + step * c[3], u)
                x += step / 6.0 * (a[0] + 2.0 * b[0] + 2.0 * c[0] + d[0])
                v += step / 6.0 * (a[1] + 2.0 * b[1] + 2.0 * c[1] + d[1])
                p_a += step / 6.0 * (a[2] + 2.0 * b[2] + 2.0 * c[2] + d[2])
                p_b += step / 6.0 * (a[3] + 2.0 * b[3] + 2.0 * c[3] + d[3])
