# SPDX-License-Identifier: Apache-2.0
"""Chamber equations: pressure and hydraulic force that the recorded valve current and motion build per sample.

The two chamber equations (paper eq. q13, physics.md) are integrated from sample to sample. Displacement is the
difference of recorded positions, exactly; flow is the mean opening of the valve within the sample times the root of the
pressure drop at its middle.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray, Memory, Oil, Openings, changes
from hydro_diagnosis.model import kernels
from hydro_sim.model import equations as eq
from hydro_sim.model.bench import Bench

SUBSTEPS = 4
"""Substeps per sample of the spool's position: the current is held for a sample, the spool is not."""
_FIRST_MOMENT = (0.5 - (np.arange(SUBSTEPS) + 0.5) / SUBSTEPS) / SUBSTEPS


def moves_spool(claim: Claim) -> bool:
    """Whether a claim acts between the current and the edges, where a sample's command need not stay constant."""
    return changes(claim, "command")


def nominal_openings(bench: Bench, spool: FloatArray) -> Openings:
    """Zero-lapped valve: conductances from the spool position [A], shape (..., substeps)."""
    mean = np.full(spool.shape[-1], bench.valve_gain / spool.shape[-1])
    positive = np.maximum(spool, 0.0) @ mean
    negative = positive - spool @ mean
    return Openings(positive, negative, negative, positive)


def spool_position(current: FloatArray, substep: float, claims: Sequence[Claim]) -> FloatArray:
    """Spool position [A], shape (n, substeps), from the recorded current of shape (n,).

    An unshaped current is constant within a sample and needs only one substep.
    """
    moving = sorted((claim for claim in claims if moves_spool(claim)), key=lambda claim: claim.effect.stage)
    if current.ndim == 1:
        current = np.repeat(current[:, None], SUBSTEPS if moving else 1, axis=1)
    spool = current
    for claim in moving:
        spool = claim.effect.command(spool, substep, claim.values)
    return spool


def net_flows(bench: Bench, oil: Oil, claims: Sequence[Claim], memory: Memory) -> tuple[FloatArray, FloatArray]:
    """Flow [m3/s] into chamber A and into chamber B, leaks included."""
    tank, (p_a, p_b) = bench.tank_pressure, oil.pressures
    flows = np.empty_like(p_a), np.empty_like(p_b)
    if any(changes(claim, "openings") or changes(claim, "supply") for claim in claims):
        edges, supply = _fed(bench, oil, claims, memory)
        openings = edges.supply_a, edges.a_tank, edges.supply_b, edges.b_tank
        kernels.edge_flows(*flows, *openings, p_a, p_b, supply, tank)
    else:
        kernels.nominal_flows(*flows, bench.valve_gain, oil.spool, p_a, p_b, bench.supply_pressure, tank)
    for claim in claims:
        flows = claim.effect.flows(flows, oil.pressures, tank, claim.values)
        flows = claim.effect.inflows(flows, oil, memory, claim.values)
    return flows


def _fed(bench: Bench, oil: Oil, claims: Sequence[Claim], memory: Memory) -> tuple[Openings, FloatArray]:
    """The valve's edges and the supply pressure [Pa] under the claims."""
    edges = nominal_openings(bench, oil.spool)
    for claim in claims:
        edges = claim.effect.openings(edges, oil.spool, oil.time, claim.values)
    p_a, p_b = oil.pressures
    supply = np.full_like(p_a, bench.supply_pressure)
    sagging = [claim for claim in claims if changes(claim, "supply")]
    for _ in range(3 if sagging else 0):
        (drop_a, _), (_, drop_b) = eq.edge_drops(supply, bench.tank_pressure, p_a, p_b)
        demand = edges.supply_a * eq.signed_root(drop_a) + edges.supply_b * eq.signed_root(drop_b)
        supply = np.full_like(p_a, bench.supply_pressure)
        for claim in sagging:
            supply = claim.effect.supply(supply, demand, memory, claim.values)
    return edges, supply


def compliances(bench: Bench, oil: Oil, claims: Sequence[Claim]) -> tuple[FloatArray, FloatArray]:
    """beta/V [Pa/m3] of both chambers."""
    softer = [claim for claim in claims if changes(claim, "stiffness")]
    moduli: list[FloatArray | float] = [bench.bulk_modulus, bench.bulk_modulus]
    if softer:
        moduli = [_modulus(bench, pressure, softer) for pressure in oil.pressures]
    stiff: tuple[FloatArray, FloatArray] = eq.stiffnesses(bench, (moduli[0], moduli[1]), oil.position)
    return stiff


def _modulus(bench: Bench, pressure: FloatArray, claims: Sequence[Claim]) -> FloatArray:
    modulus = np.full_like(pressure, bench.bulk_modulus)
    for claim in claims:
        modulus = claim.effect.stiffness(modulus, pressure, claim.values)
    return modulus


@dataclass(frozen=True)
class ChamberRun:
    """Result of the chamber equations on a segment."""

    innovations: tuple[FloatArray, FloatArray]
    """Pa, shape (n,), not smoothed."""
    arc: FloatArray
    """N, shape (n,): by how much the mean of f_h around a sample exceeds what straight lines between samples give."""
    built_force: FloatArray
    """N, shape (n,): what each sample adds to f_h."""


def force_arc(
    bench: Bench, oil: Oil, stiff: tuple[FloatArray, FloatArray], acceleration: FloatArray, step: float
) -> FloatArray:
    """dt times the integral of f_h'(s) (1/2 - s) over a sample, s from 0 to 1 (Euler-Maclaurin) [N], shape (n,)."""
    moment = _FIRST_MOMENT if oil.spool.shape[-1] == SUBSTEPS else np.zeros(1)
    flows = kernels.first_moments(
        bench.valve_gain, moment, oil.spool, *oil.pressures, bench.supply_pressure, bench.tank_pressure
    )
    per_interval = eq.force_rate(bench, stiff, flows, -acceleration * step / 12.0) * step
    around: FloatArray = 0.5 * (per_interval + np.concatenate([per_interval[:1], per_interval[:-1]]))
    return around


def middle(signal: FloatArray) -> FloatArray:
    """Mean of each sample and the next, shape (n,); the last repeats."""
    between: FloatArray = 0.5 * (signal + np.concatenate([signal[1:], signal[-1:]]))
    return between
