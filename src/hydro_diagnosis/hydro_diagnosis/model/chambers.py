# SPDX-License-Identifier: Apache-2.0
"""Chamber equations: increments of pressure and hydraulic force per sample, from recorded valve current and motion.

The two chamber equations (paper eq. q13, physics.md) are integrated from sample to sample. Displacement is the
difference of recorded positions, exactly; flow is the mean opening of the valve within the sample times the root of the
pressure drop at its middle.

The compiled loops run once over arrays of shape (n,); results are written into arrays that are passed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hydro_diagnosis.effects.base import (
    ChamberInputs,
    EffectHypothesis,
    FloatArray,
    Pair,
    claims_acting_in,
    substep_mean,
)
from hydro_diagnosis.effects.memory import Memory
from hydro_sim.jit import njit
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench
from hydro_sim.model.compiled_equations import equations as compiled


@njit
def edge_flows(into_a, into_b, edges, p_a, p_b, supply, tank):
    """Write the flows [m3/s] through the edges into both chambers; all arguments have shape (n,).

    `edges`: conductances [m3/s/sqrt(Pa)] of the four edges (`equations.EDGES`).
    """
    pa, at, pb, bt = edges
    for k in range(len(p_a)):
        out, back = compiled.edge_drops(supply[k], tank[k], p_a[k], p_b[k])
        into_a[k] = pa[k] * compiled.signed_root(out[0]) - at[k] * compiled.signed_root(back[0])
        into_b[k] = pb[k] * compiled.signed_root(back[1]) - bt[k] * compiled.signed_root(out[1])


@njit
def _flows(positive, negative, p_a, p_b, supply, tank):
    """Flows [m3/s] into both chambers, by conductances [m3/s/sqrt(Pa)] of the edges that extend, and that retract."""
    out, back = compiled.edge_drops(supply, tank, p_a, p_b)
    a, b = 0.0, 0.0
    if positive != 0.0:
        a += positive * compiled.signed_root(out[0])
        b -= positive * compiled.signed_root(out[1])
    if negative != 0.0:
        a -= negative * compiled.signed_root(back[0])
        b += negative * compiled.signed_root(back[1])
    return a, b


@njit
def nominal_flows(into_a, into_b, gain, spool, p_a, p_b, supply, tank):
    """Write the flows [m3/s] of a zero-lapped valve into both chambers; `spool` [A]: (n, substeps), pressures: Pa."""
    share = gain / spool.shape[1]
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * share
            negative -= min(spool[k, s], 0.0) * share
        into_a[k], into_b[k] = _flows(positive, negative, p_a[k], p_b[k], supply, tank)


@njit
def flow_first_moments(gain, moment, spool, p_a, p_b, supply, tank):
    """Flows [m3/s] into chambers A and B, summed over a sample's substeps with weights `moment`, (substeps,)."""
    into_a, into_b = np.empty_like(p_a), np.empty_like(p_b)
    for k in range(len(p_a)):
        positive, negative = 0.0, 0.0
        for s in range(spool.shape[1]):
            positive += max(spool[k, s], 0.0) * moment[s]
            negative -= min(spool[k, s], 0.0) * moment[s]
        into_a[k], into_b[k] = _flows(gain * positive, gain * negative, p_a[k], p_b[k], supply, tank)
    return into_a, into_b


OBSERVER_TIME_CONSTANT = 0.12
"""Time constant [s] of the observer. A shorter one suppresses the slow drift that a small leak causes."""
AVERAGING_TIME = 0.1
"""Averaging time [s] of the hydraulic balance."""


def observer_gain(step: float) -> float:
    """Return the observer's gain per sample of `step` [s]: at most 1, beyond which it would oscillate, and run away."""
    return min(step / OBSERVER_TIME_CONSTANT, 1.0)


@njit
def innovations(recorded, increments, gain):
    """Innovations of an observer, shape (n,): a recorded signal less the sum of `increments`, high-passed.

    The slow part subtracted is a first-order low-pass of `gain` per sample, from the mean of the first ten samples.
    """
    beyond = np.empty_like(recorded)
    total = 0.0
    for k in range(len(recorded)):
        beyond[k] = recorded[k] - total
        total += increments[k]
    slow = beyond[:10].mean()
    for k in range(len(recorded)):
        now = beyond[k]
        beyond[k] = now - slow
        slow += gain * (now - slow)
    return beyond


SUBSTEPS = 4
"""Substeps per sample of the spool's position: the current is held for a sample, the spool is not."""


def net_flows(bench: Bench, oil: ChamberInputs, claims: Sequence[EffectHypothesis], memory: Memory) -> Pair:
    """Return the flows [m3/s] into chambers A and B under claims, leakage included."""
    p_a, p_b = oil.pressures
    flows = np.empty_like(p_a), np.empty_like(p_b)
    if claims_acting_in(claims, "underlap", "land", "openings", "supply", "tank"):
        all_wide = 0.0

        def openings(width: float) -> Pair:
            gain = bench.valve_gain
            edges: Pair = (np.maximum(width + oil.spool, 0.0) * gain, np.maximum(width - oil.spool, 0.0) * gain)
            for claim in claims_acting_in(claims, "openings"):
                edges = claim.effect.openings(edges, oil.spool, oil.time, claim.values)
            return substep_mean(edges[0]), substep_mean(edges[1])

        for claim in claims_acting_in(claims, "underlap"):
            all_wide = claim.effect.underlap(all_wide, claim.values)
        out, back = openings(all_wide)
        edges = [out, back, back, out]
        for claim in claims_acting_in(claims, "land"):
            (width, share), k = claim.effect.land(all_wide, claim.values), eq.EDGES.index(claim.effect.physics.edge)
            edges[k] = share * openings(width)[eq.OPENS_BACK[k]]
        pa, at, pb, bt = edges
        supply, tank = np.full_like(p_a, bench.supply_pressure), np.full_like(p_a, bench.tank_pressure)
        for claim in claims_acting_in(claims, "supply"):
            supply = claim.effect.supply(supply, (pa, p_a, pb, p_b), bench, memory, claim.values)
        for claim in claims_acting_in(claims, "tank"):
            tank = claim.effect.tank(tank, (bt, p_b, at, p_a), bench, memory, claim.values)
        edge_flows(*flows, (pa, at, pb, bt), p_a, p_b, supply, tank)
    else:
        nominal_flows(*flows, bench.valve_gain, oil.spool, p_a, p_b, bench.supply_pressure, bench.tank_pressure)
    for claim in claims_acting_in(claims, "leaks"):
        flows = claim.effect.leaks(flows, oil, bench, memory, claim.values)
    return flows


def chamber_stiffnesses(bench: Bench, oil: ChamberInputs, claims: Sequence[EffectHypothesis]) -> Pair:
    """Return the stiffnesses beta/V [Pa/m3] of the oil in both chambers under claims."""
    softer = claims_acting_in(claims, "modulus")
    moduli: list[Any] = [bench.bulk_modulus, bench.bulk_modulus]
    for k, pressure in enumerate(oil.pressures if softer else ()):
        moduli[k] = np.full_like(pressure, bench.bulk_modulus)
        for claim in softer:
            moduli[k] = claim.effect.modulus(moduli[k], pressure, claim.values, oil.time)
    stiff: Pair = eq.stiffnesses(bench, (moduli[0], moduli[1]), oil.position)
    return stiff


@dataclass(frozen=True)
class ChamberRun:
    """Result of the chamber equations on a segment."""

    innovations: Pair
    """Pa, shape (n,), not smoothed."""
    interpolation_error: FloatArray
    """Excess [N], shape (n,), of the mean of f_h around a sample over that of its linear interpolation."""
    force_increments: FloatArray
    """Increment [N] of f_h in each sample, shape (n,)."""


def force_interpolation_error(
    bench: Bench, oil: ChamberInputs, stiff: Pair, acceleration: FloatArray, step: float
) -> FloatArray:
    """`ChamberRun.interpolation_error` [N], (n,): dt times the integral of f_h'(s) (1/2 - s), s in a sample 0 to 1.

    By the Euler-Maclaurin formula.
    """
    moment = (0.5 - (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS) / SUBSTEPS
    moment = moment if oil.spool.shape[-1] == SUBSTEPS else np.zeros(1)
    flows = flow_first_moments(
        bench.valve_gain, moment, oil.spool, *oil.pressures, bench.supply_pressure, bench.tank_pressure
    )
    per_interval = eq.force_rate(bench, stiff, flows, -acceleration * step / 12.0) * step
    around: FloatArray = 0.5 * (per_interval + np.concatenate([per_interval[:1], per_interval[:-1]]))
    return around


def interval_means(signal: FloatArray) -> FloatArray:
    """Values at the middles of the sample intervals: means of each sample and the next, the last repeated, (n,)."""
    between: FloatArray = 0.5 * (signal + np.concatenate([signal[1:], signal[-1:]]))
    return between
