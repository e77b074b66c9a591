# SPDX-License-Identifier: Apache-2.0
"""What amplifiers and scales of the five sensors make of the truth, before noise. Compiled.

`raw` has the order of `model.sensors.RAW_FIELDS`. Low-passes come first, then gains and biases in the order of the
bench file: a linear lag with a gain of one may change places with both.
"""

from __future__ import annotations

from numba import njit

from hydro_sim.model.effects.record import LAG, MEASURE

RATIO, BIAS = range(2)
"""Kinds of MEASURE. Numbers: ratio or bias, channel. An entry of LAG: F (4), early (2), late (2), channel."""

CHANNEL = 8
"""Where an entry of LAG keeps its channel."""


@njit(cache=True)
def begin(program, memory, raw):
    """Put the low-passes into equilibrium with true values `raw`, shape (5,)."""
    for k in range(program.first[LAG], program.first[LAG + 1]):
        signal = raw[int(program.value[k, CHANNEL])]
        memory.lag[k, 0], memory.lag[k, 1], memory.input[k] = signal, 0.0, signal


@njit(cache=True)
def follow(program, memory, raw):
    """Move the low-passes on by one Runge-Kutta step, in which their inputs go straight to `raw`; overwrites it."""
    for k in range(program.first[LAG], program.first[LAG + 1]):
        value, lag, channel = program.value[k], memory.lag[k], int(program.value[k, CHANNEL])
        early, late = memory.input[k], raw[channel]
        position = value[0] * lag[0] + value[1] * lag[1] + value[4] * early + value[6] * late
        lag[1] = value[2] * lag[0] + value[3] * lag[1] + value[5] * early + value[7] * late
        lag[0], memory.input[k], raw[channel] = position, late, position


@njit(cache=True)
def show(program, memory, raw):
    """Make true values `raw`, shape (5,), into what the sensors show but for noise, in place."""
    for k in range(program.first[LAG], program.first[LAG + 1]):
        raw[int(program.value[k, CHANNEL])] = memory.lag[k, 0]
    for k in range(program.first[MEASURE], program.first[MEASURE + 1]):
        channel = int(program.value[k, 1])
        if program.kind[k] == RATIO:
            raw[channel] *= program.value[k, 0]
        else:
            raw[channel] += program.value[k, 0]
