# SPDX-License-Identifier: Apache-2.0
"""Valve: dead time, spool, four edges, and leakage past and between them.

Spool positions are in amperes of the command that would hold them.
"""

from __future__ import annotations

import math

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.emulator.truth.parameters import DELAY_SAMPLES
from hydro_sim.jit import njit

LAMINAR_DROP = 2e3  # Pa: below about this an orifice's flow is laminar, so that its slope at zero drop is finite


@njit
def delayed_command(p, commands, sample, elapsed):
    """Command [A] that reaches the valve `elapsed` seconds into `sample`; `commands` is a ring of the last ones."""
    late = math.floor((elapsed - p.delay) / SAMPLE_PERIOD + 1e-9)  # the margin keeps multiples of the sample exact
    return commands[(sample + int(late)) % DELAY_SAMPLES]


@njit
def spool_derivative(p, command, spool, spool_rate):
    """Rate of the spool [A/s] and of its rate [A/s2]; both zero for an ideal spool, which follows by itself."""
    target = command + p.valve_offset
    if p.spool_order == 2.0:
        pull = p.spool_frequency * (target - spool) - 2.0 * p.spool_damping * spool_rate
        return min(max(spool_rate, -p.spool_rate_limit), p.spool_rate_limit), p.spool_frequency * pull
    if p.spool_order == 1.0:
        rate = p.spool_frequency * (target - spool)
        return min(max(rate, -p.spool_rate_limit), p.spool_rate_limit), 0.0
    return 0.0, 0.0


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
    """Coefficient [m3/s/sqrt(Pa)] that every edge leaks besides its opening."""
    if p.null_leak == 0.0:
        return 0.0
    distance = abs(spool) / p.null_width
    if p.null_hyperbolic == 1.0:
        return p.null_leak / (1.0 + distance)
    return p.null_leak * math.exp(-distance * distance)


@njit
def orifice_flow(coefficient, drop):
    """Flow [m3/s] with sqrt(|drop|) and the drop's sign, laminar below `LAMINAR_DROP`."""
    return coefficient * drop / math.sqrt(math.sqrt(drop * drop + LAMINAR_DROP * LAMINAR_DROP))


@njit
def gain_over_time(p, time):
    """Relative gain of all edges at `time` [s]: drift and warming up."""
    warming = 0.0 if p.warm_change == 0.0 else p.warm_change * (1.0 - math.exp(-time / p.warm_time))
    return max((1.0 + p.gain_drift * time) * (1.0 + warming), 0.0)


@njit
def edge_flows(p, spool, gain, pressure_a, pressure_b, supply):
    """Flows [m3/s] supply -> A, A -> tank, supply -> B, B -> tank at the spool's position [A]."""
    leak = null_leak(p, spool)
    extending = gain * p.gain_positive * p.orifice * opening(p, spool, p.overlap_positive) + leak
    retracting = gain * p.gain_negative * p.orifice * opening(p, -spool, p.overlap_negative) + leak
    return (
        orifice_flow(extending, supply - pressure_a),
        orifice_flow(retracting, pressure_a - p.tank_pressure),
        orifice_flow(retracting, supply - pressure_b),
        orifice_flow(extending, pressure_b - p.tank_pressure),
    )


@njit
def leak_a_to_b(p, drop):
    """Flow [m3/s] past the piston's seal at `drop` = p_a - p_b [Pa]."""
    return p.leak_internal * drop + orifice_flow(p.leak_internal_orifice, drop)
