# SPDX-License-Identifier: Apache-2.0
"""Random excitation: seeded references and gains that cover the working range, for training recordings."""

from __future__ import annotations

from dataclasses import dataclass
from math import log, pi

import numpy as np

from hydro_bridge.signals import Waveform
from hydro_sim.excitation.schedules import Segment, name_of
from hydro_sim.model.bench import NOMINAL


@dataclass(frozen=True, kw_only=True)
class Range:
    """Ranges of the excitation. The defaults do not trip the nominal bench or the emulator's default truth."""

    seconds: tuple[float, float] = (2.0, 6.0)
    """s, of one segment."""
    force_max: float = NOMINAL.force * 22.0 / 15.0
    """N, |offset| + amplitude."""
    offset_max: float = NOMINAL.force * 11.0 / 15.0
    """N, |offset|."""
    force_rate_max: float = NOMINAL.force * 40.0 / 3.0
    """N/s, peak of the reference's rate."""
    frequency: tuple[float, float] = (0.15, 4.0)
    """Hz, drawn evenly on a logarithmic scale."""
    kp: tuple[float, float] = (15.0, 75.0)
    """1/s, what the guard lets through; the emulated bench is stable to about 120 in small motions, less in large
    ones.
    """
    ki: tuple[float, float] = (5.0, 15.0)
    """1/s^2, what the guard lets through."""

    @classmethod
    def of_force(cls, force: float) -> Range:
        """Return the defaults for a bench whose size has this force [N]."""
        share, usual = force / NOMINAL.force, cls()
        return cls(
            force_max=share * usual.force_max, offset_max=share * usual.offset_max,
            force_rate_max=share * usual.force_rate_max,
        )  # fmt: skip


SHARES = {Waveform.HOLD: 0.1, Waveform.SINE: 0.35, Waveform.MULTISINE: 0.4, Waveform.SMOOTH_STEP: 0.15}
"""Probability of each waveform."""

STEEPNESS = {Waveform.HOLD: 0.0, Waveform.SINE: 1.0, Waveform.MULTISINE: 1.8, Waveform.SMOOTH_STEP: 4.0}
"""Peak rate of each waveform over amplitude times 2 pi frequency (hydro_sim.box.reference)."""


def draw(seconds: float, seed: int, limits: Range | None = None) -> list[Segment]:
    """Draw a schedule of that length [s]; the same seed gives the same one."""
    limits, generator = limits or Range(), np.random.default_rng(seed)
    segments: list[Segment] = []
    left = round(seconds, 3)
    while left > 0.0:
        length = round(float(generator.uniform(*limits.seconds)), 3)
        segments.append(_segment(min(length, left), limits, generator))
        left = round(left - segments[-1].seconds, 3)
    return segments


def _segment(seconds: float, limits: Range, generator: np.random.Generator) -> Segment:
    waveform = list(SHARES)[int(generator.choice(len(SHARES), p=list(SHARES.values())))]
    offset = generator.uniform(-limits.offset_max, limits.offset_max)
    frequency = np.exp(generator.uniform(log(limits.frequency[0]), log(limits.frequency[1])))
    steep = STEEPNESS[waveform] * 2.0 * pi * frequency
    largest = min(limits.force_max - abs(offset), limits.force_rate_max / max(steep, 1e-9))
    amplitude = generator.uniform(0.05, 1.0) * largest if waveform != Waveform.HOLD else 0.0
    phase, kp, ki = generator.uniform(0.0, 2.0 * pi), generator.uniform(*limits.kp), generator.uniform(*limits.ki)
    numbers = (round(float(number), 4) for number in (amplitude, offset, frequency, phase, kp, ki))
    amplitude, offset, frequency, phase, kp, ki = numbers
    return Segment(
        seconds=seconds, waveform=name_of(waveform), amplitude=amplitude, offset=offset, frequency=frequency,
        phase=phase, kp=kp, ki=ki,
    )  # fmt: skip
