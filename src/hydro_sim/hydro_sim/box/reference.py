# SPDX-License-Identifier: Apache-2.0
"""Reference force: waveforms with three exact derivatives, and cross-fades without jumps in value or rate.

A signal runs on its own time t, zero when the box takes it up; a is its amplitude, o its offset, f its frequency:

=========== ==========================================================================
HOLD        o
SINE        o + a sin(2 pi f t + phase)
MULTISINE   o + a sum_i w_i sin(2 pi f r_i t + i phase), r = sqrt(1, 3, 7, 13), w_i ~ 1/r_i, sum w = 1
SMOOTH_STEP o -/+ a, half a period each; the edges are raised cosines that last an eighth of a period
=========== ==========================================================================

A new signal is faded in over 0.3 s, f_r = (1 - s) old + s new with s = 3 z^2 - 2 z^3. A change that comes during a fade
waits for its end, and only the last one counts. Arming fades in from the force. Derivatives are exact; at the ends of
edges and fades, where f_r'' jumps, they are those of the side that follows, without impulses.
"""

from __future__ import annotations

import math

import numpy as np

from hydro_bridge.signals import FloatArray, ReferenceSignal, Waveform
from hydro_sim.jit import njit

FADE = 0.3
"""Length [s] of a cross-fade."""

EDGE = 0.125
"""Length of a smooth step's edge in periods."""

RATIOS = (1.0, math.sqrt(3.0), math.sqrt(7.0), math.sqrt(13.0))
"""Frequencies of the multisine over its lowest; no two share a period."""

WEIGHTS = tuple(1.0 / ratio / sum(1.0 / other for other in RATIOS) for ratio in RATIOS)
"""Amplitudes of the multisine over its peak: each sine has the same rate."""

SIGNAL_DTYPE = np.dtype(
    [("waveform", np.int64)] + [(name, np.float64) for name in ("amplitude", "offset", "frequency", "phase", "start")]
)
"""A `ReferenceSignal` and the box time [s] at which it began."""

REFERENCE_DTYPE = np.dtype(
    [("old", SIGNAL_DTYPE), ("new", SIGNAL_DTYPE), ("wanted", SIGNAL_DTYPE), ("fade_start", np.float64)]
)
"""State of the generator: `new` fades in over `old` from `fade_start` on; `wanted` is the latest request."""

HOLD, SINE, MULTISINE = int(Waveform.HOLD), int(Waveform.SINE), int(Waveform.MULTISINE)


@njit
def signal(parameters, time):
    """f [N], f' [N/s], f'' [N/s^2], f''' [N/s^3] of one `SIGNAL_DTYPE` record at box time [s]."""
    omega = 2.0 * math.pi * parameters.frequency
    angle = omega * (time - parameters.start)
    if parameters.waveform == HOLD:
        shape, slope, second, third = 0.0, 0.0, 0.0, 0.0
    elif parameters.waveform == SINE:
        shape, slope = math.sin(angle + parameters.phase), math.cos(angle + parameters.phase)
        second, third = -shape, -slope
    elif parameters.waveform == MULTISINE:
        shape, slope, second, third = _multisine(angle, parameters.phase)
    else:
        shape, slope, second, third = _smooth_step(angle + parameters.phase)
    rate = parameters.amplitude * omega
    value = parameters.offset + parameters.amplitude * shape
    return value, rate * slope, rate * omega * second, rate * omega * omega * third


@njit
def _multisine(angle, phase):
    shape, slope, second, third = 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        inner = RATIOS[i] * angle + (i + 1) * phase
        sine, cosine = WEIGHTS[i] * math.sin(inner), WEIGHTS[i] * RATIOS[i] * math.cos(inner)
        shape += sine
        slope += cosine
        second -= RATIOS[i] * RATIOS[i] * sine
        third -= RATIOS[i] * RATIOS[i] * cosine
    return shape, slope, second, third


@njit
def _smooth_step(angle):
    """Shape, and its three derivatives by the angle: from -1 to 1 at angle 0, back at pi."""
    turn = (angle / (2.0 * math.pi)) % 1.0
    side = 1.0 if turn < 0.5 else -1.0
    share = (turn % 0.5) / EDGE
    if share >= 1.0:
        return side, 0.0, 0.0, 0.0
    steep = 1.0 / (2.0 * EDGE)
    cosine, sine = side * math.cos(math.pi * share), side * math.sin(math.pi * share)
    return -cosine, sine / (2.0 * EDGE), steep * steep * cosine, -steep * steep * steep * sine


@njit
def copy_signal(source, target):
    """Copy all but the start."""
    target.waveform, target.amplitude, target.offset = source.waveform, source.amplitude, source.offset
    target.frequency, target.phase = source.frequency, source.phase


@njit
def _same(one, other):
    levels = one.waveform == other.waveform and one.amplitude == other.amplitude and one.offset == other.offset
    return levels and one.frequency == other.frequency and one.phase == other.phase


@njit
def begin(state, force, time):
    """Start the wanted signal from a held force [N] at box time [s]: value and rate begin at (force, 0)."""
    state.old.waveform, state.old.amplitude, state.old.offset = HOLD, 0.0, force
    _take_up(state, time)


@njit
def _take_up(state, time):
    copy_signal(state.wanted, state.new)
    state.new.start = time
    state.fade_start = time


@njit
def advance(state, time):
    """f_r [N] and three derivatives at box time [s]; a fade that has ended gives way to what is wanted by now."""
    if time - state.fade_start >= FADE and not _same(state.wanted, state.new):
        copy_signal(state.new, state.old)
        state.old.start = state.new.start
        _take_up(state, time)
    value, rate, second, third = signal(state.new, time)
    share = (time - state.fade_start) / FADE
    if share >= 1.0:
        return value, rate, second, third
    old_value, old_rate, old_second, old_third = signal(state.old, time)
    blend = share * share * (3.0 - 2.0 * share)
    blend_1 = 6.0 * share * (1.0 - share) / FADE
    blend_2, blend_3 = (6.0 - 12.0 * share) / (FADE * FADE), -12.0 / (FADE * FADE * FADE)
    gap, gap_rate, gap_second = value - old_value, rate - old_rate, second - old_second
    third = (1.0 - blend) * old_third + blend * third
    third += 3.0 * blend_1 * gap_second + 3.0 * blend_2 * gap_rate + blend_3 * gap
    second = (1.0 - blend) * old_second + blend * second + 2.0 * blend_1 * gap_rate + blend_2 * gap
    rate = (1.0 - blend) * old_rate + blend * rate + blend_1 * gap
    return (1.0 - blend) * old_value + blend * value, rate, second, third


def sample(reference: ReferenceSignal, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Value [N] and rate [N/s] of a signal that began at 0, at `times` [s], shape (n,): for plots and for planning."""
    record = np.zeros(1, SIGNAL_DTYPE)
    record[0] = (reference.waveform, reference.amplitude, reference.offset, reference.frequency, reference.phase, 0.0)
    values, rates = np.empty(len(times)), np.empty(len(times))
    _sample(record, np.asarray(times, np.float64), values, rates)
    return values, rates


@njit
def _sample(record, times, values, rates):
    for i in range(len(times)):
        values[i], rates[i] = signal(record[0], times[i])[:2]
