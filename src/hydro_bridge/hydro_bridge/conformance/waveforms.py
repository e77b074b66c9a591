# SPDX-License-Identifier: Apache-2.0
"""Independent implementation of the references defined in protocol.md; shares no code with any box."""

from __future__ import annotations

from math import cos, pi, sin, sqrt

from hydro_bridge.signals import ReferenceSignal, Waveform

FADE = 0.3
"""s, length of a cross-fade."""

_RATIOS = tuple(map(sqrt, (1.0, 3.0, 7.0, 13.0)))
_WEIGHTS = tuple(1.0 / ratio / sum(1.0 / other for other in _RATIOS) for ratio in _RATIOS)

Point = tuple[float, float]
"""Value [N] and rate [N/s]."""


def shape(signal: ReferenceSignal, time: float) -> Point:
    """Return a signal's point at `time` [s] after the box accepted it."""
    omega = 2.0 * pi * signal.frequency
    angle = omega * time + signal.phase
    if signal.waveform is Waveform.HOLD:
        value, slope = 0.0, 0.0
    elif signal.waveform is Waveform.SINE:
        value, slope = sin(angle), cos(angle)
    elif signal.waveform is Waveform.MULTISINE:
        inner = [ratio * omega * time + (i + 1) * signal.phase for i, ratio in enumerate(_RATIOS)]
        value = sum(weight * sin(each) for weight, each in zip(_WEIGHTS, inner, strict=True))
        slope = sum(w * r * cos(each) for w, r, each in zip(_WEIGHTS, _RATIOS, inner, strict=True))
    else:
        value, slope = _smooth_step(angle)
    return signal.offset + signal.amplitude * value, signal.amplitude * omega * slope


def _smooth_step(angle: float) -> Point:
    """Return a step from -1 to 1 in the eighth of a period after angle 0, and back after pi."""
    turn = angle / (2.0 * pi) % 1.0
    side, inside = (1.0, turn) if turn < 0.5 else (-1.0, turn - 0.5)
    if inside >= 0.125:
        return side, 0.0
    return -side * cos(8.0 * pi * inside), 4.0 * side * sin(8.0 * pi * inside)


def faded(old: Point, new: Point, time: float) -> Point:
    """Return the point at `time` [s] into a cross-fade."""
    z = time / FADE
    if z >= 1.0:
        return new
    s, rate = 3.0 * z**2 - 2.0 * z**3, 6.0 * z * (1.0 - z) / FADE
    return old[0] + s * (new[0] - old[0]), (1.0 - s) * old[1] + s * new[1] + rate * (new[0] - old[0])
