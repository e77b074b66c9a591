# SPDX-License-Identifier: Apache-2.0
"""From the valve current to the four edges: dead time, spool, overlap, gain, wear. Compiled.

A Runge-Kutta step sees the spool's mean over the step: currents are held for a sample, so dead times and linear lags
are exact on average. Sources: Merritt 1967, sections 5-3 to 5-6; the diagnosis' `effects.valve`, `.valve_dynamics`.
"""

from __future__ import annotations

import math

from numba import njit

from hydro_sim.model.effects.record import COMMAND, HISTORY, OPENINGS, SUBSTEPS

DELAY, OFFSET, SECOND_ORDER, FIRST_ORDER, OVERLAP, OVERLAP_SOFT = range(6)
"""Kinds of COMMAND. Numbers: none, dead times are the program's `delay` | current | see `effects.lags`, twice |
widths on the positive and the negative side | width, softness."""

GAIN, GAIN_NEGATIVE, GAIN_DRIFT, WEAR_EXPONENTIAL, WEAR_GAUSSIAN, WEAR_HYPERBOLIC, WEAR_LORENTZIAN = range(7)
"""Kinds of OPENINGS. Numbers: ratio | ratio | rate | coefficient, width."""

DRIFT_LOW, DRIFT_HIGH = 0.2, 5.0
"""Bounds of a gain that drifts with time: a simulation may run for hours."""


@njit(cache=True)
def begin(program, memory):
    """Put the spool where no current holds it."""
    memory.current[:] = 0.0
    spool = 0.0
    for k in range(program.first[COMMAND], program.first[COMMAND + 1]):
        if program.kind[k] == OFFSET:
            spool += program.value[k, 0]
        memory.lag[k, 0], memory.lag[k, 1] = spool, 0.0


@njit(cache=True)
def hold(program, memory, current):
    """Note the current [A] of the sample that begins."""
    if program.delay > 0.0:
        for k in range(HISTORY - 1, 0, -1):
            memory.current[k] = memory.current[k - 1]
    memory.current[0] = current


@njit(cache=True)
def _delayed(program, memory, step):
    """Mean current [A] over a step of the present sample, `delay` earlier."""
    if program.delay == 0.0:
        return memory.current[0]
    width = 1.0 / SUBSTEPS
    begin = step * width - program.delay
    sample = math.floor(begin)
    later = max(begin + width - sample - 1.0, 0.0) / width
    age = -int(sample)
    return memory.current[age] * (1.0 - later) + memory.current[max(age - 1, 0)] * later


@njit(cache=True)
def command(program, memory, step):
    """Mean position of the spool [A] over Runge-Kutta step `step` of the present sample; moves its lags on."""
    spool = _delayed(program, memory, step)
    for k in range(program.first[COMMAND], program.first[COMMAND + 1]):
        kind, value, lag = program.kind[k], program.value[k], memory.lag[k]
        if kind == OFFSET:
            spool += value[0]
        elif kind == SECOND_ORDER:
            mean = value[6] * lag[0] + value[7] * lag[1] + value[8] * spool
            position = value[0] * lag[0] + value[1] * lag[1] + value[4] * spool
            lag[1] = value[2] * lag[0] + value[3] * lag[1] + value[5] * spool
            lag[0], spool = position, mean
        elif kind == FIRST_ORDER:
            before = lag[0]
            lag[0] = spool + (before - spool) * value[0]
            spool += (before - spool) * value[1]
        elif kind == OVERLAP:
            spool -= min(max(spool, -value[1]), value[0])
        else:
            spool = _softened(spool, value[0], value[1])
    return spool


@njit(cache=True)
def _softened(spool, width, softness):
    """Each side is a softplus of what exceeds the half width."""
    return softness * (_softplus((spool - width) / softness) - _softplus((-spool - width) / softness))


@njit(cache=True)
def _softplus(ratio):
    return max(ratio, 0.0) + math.log1p(math.exp(-abs(ratio)))


@njit(cache=True)
def openings(program, valve_gain, spool, time):
    """Conductance [m3/s/sqrt(Pa)] of the edges that drive the piston out and of those that drive it back.

    Supply-A and B-tank open together, and so do supply-B and A-tank; `time` in s since reset.
    """
    out, back = valve_gain * max(spool, 0.0), valve_gain * max(-spool, 0.0)
    for k in range(program.first[OPENINGS], program.first[OPENINGS + 1]):
        kind, value = program.kind[k], program.value[k]
        if kind == GAIN:
            out, back = out * value[0], back * value[0]
        elif kind == GAIN_NEGATIVE:
            back *= value[0]
        elif kind == GAIN_DRIFT:
            ratio = min(max(1.0 + value[0] * time, DRIFT_LOW), DRIFT_HIGH)
            out, back = out * ratio, back * ratio
        else:
            wear = value[0] * _profile(kind, abs(spool) / value[1])
            out, back = out + wear, back + wear
    return out, back


@njit(cache=True)
def _profile(kind, ratio):
    if kind == WEAR_EXPONENTIAL:
        return math.exp(-ratio)
    if kind == WEAR_GAUSSIAN:
        return math.exp(-ratio * ratio)
    return 1.0 / (1.0 + ratio) if kind == WEAR_HYPERBOLIC else 1.0 / (1.0 + ratio * ratio)
