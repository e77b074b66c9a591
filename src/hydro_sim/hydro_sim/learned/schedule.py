# SPDX-License-Identifier: Apache-2.0
"""Random references and gains that visit the working range: what a training recording is made of.

A schedule is a list of `Stretch`, drawn from a seed; written as YAML it is what `ros2 run hydro_sim collect` plays
into the
graph, and what the emulator's offline recorder takes. A fade of 0.3 s joins the stretches (hydro_sim.reference).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import log, pi
from pathlib import Path

import numpy as np
import yaml

from hydro_bridge.signals import ReferenceSignal, Waveform


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """One reference under one pair of gains."""

    seconds: float
    """s."""
    waveform: str
    """Name of a `Waveform` in lower case."""
    amplitude: float
    """N."""
    offset: float
    """N."""
    frequency: float
    """Hz."""
    phase: float
    """rad."""
    kp: float
    """K_p [1/s], the box's base gain included."""
    ki: float
    """K_i [1/s^2], the box's base gain included."""

    @property
    def signal(self) -> ReferenceSignal:
        """The reference as it is sent."""
        waveform = Waveform[self.waveform.upper()]
        return ReferenceSignal(
            waveform=waveform, amplitude=self.amplitude, offset=self.offset, frequency=self.frequency, phase=self.phase
        )


@dataclass(frozen=True, kw_only=True)
class Range:
    """What is drawn from. The defaults keep the nominal bench and the emulator's default truth from tripping."""

    seconds: tuple[float, float] = (2.0, 6.0)
    """s, of one stretch."""
    force_max: float = 440.0
    """N, |offset| + amplitude, [1, 600]."""
    offset_max: float = 220.0
    """N, |offset|."""
    force_rate_max: float = 4000.0
    """N/s, peak of the reference's rate, [1, 2e4]."""
    frequency: tuple[float, float] = (0.15, 4.0)
    """Hz, drawn evenly on a logarithmic scale."""
    kp: tuple[float, float] = (15.0, 75.0)
    """1/s, what the guard lets through; the emulated bench is stable to about 120 in small motions, less in large
    ones.
    """
    ki: tuple[float, float] = (5.0, 15.0)
    """1/s^2, what the guard lets through."""


SHARES = {Waveform.HOLD: 0.1, Waveform.SINE: 0.35, Waveform.MULTISINE: 0.4, Waveform.SMOOTH_STEP: 0.15}
"""How often each waveform is drawn."""

STEEPNESS = {Waveform.HOLD: 0.0, Waveform.SINE: 1.0, Waveform.MULTISINE: 1.8, Waveform.SMOOTH_STEP: 4.0}
"""Peak rate of each waveform over amplitude times 2 pi frequency (hydro_sim.reference)."""


def draw(seconds: float, seed: int, limits: Range | None = None) -> list[Stretch]:
    """A schedule of that length [s]; the same seed gives the same one."""
    limits, generator = limits or Range(), np.random.default_rng(seed)
    stretches: list[Stretch] = []
    left = round(seconds, 3)
    while left > 0.0:
        length = round(float(generator.uniform(*limits.seconds)), 3)
        stretches.append(_stretch(min(length, left), limits, generator))
        left = round(left - stretches[-1].seconds, 3)
    return stretches


def _stretch(seconds: float, limits: Range, generator: np.random.Generator) -> Stretch:
    waveform = list(SHARES)[int(generator.choice(len(SHARES), p=list(SHARES.values())))]
    offset = generator.uniform(-limits.offset_max, limits.offset_max)
    frequency = np.exp(generator.uniform(log(limits.frequency[0]), log(limits.frequency[1])))
    steep = STEEPNESS[waveform] * 2.0 * pi * frequency
    largest = min(limits.force_max - abs(offset), limits.force_rate_max / max(steep, 1e-9))
    amplitude = generator.uniform(0.05, 1.0) * largest if waveform != Waveform.HOLD else 0.0
    phase, kp, ki = generator.uniform(0.0, 2.0 * pi), generator.uniform(*limits.kp), generator.uniform(*limits.ki)
    numbers = (round(float(number), 4) for number in (amplitude, offset, frequency, phase, kp, ki))
    amplitude, offset, frequency, phase, kp, ki = numbers
    return Stretch(
        seconds=seconds, waveform=waveform.name.lower(), amplitude=amplitude, offset=offset, frequency=frequency,
        phase=phase, kp=kp, ki=ki,
    )  # fmt: skip


def save(stretches: Sequence[Stretch], path: str | Path) -> None:
    """Write a schedule as YAML: a list under `segments`; missing folders are made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump({"segments": [asdict(stretch) for stretch in stretches]}, sort_keys=False)
    Path(path).write_text(text, encoding="utf-8")


def load(path: str | Path) -> list[Stretch]:
    """Read a schedule; raises ValueError in one sentence."""
    try:
        content = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
        return [Stretch(**entry) for entry in content["segments"]]
    except (OSError, UnicodeDecodeError, yaml.YAMLError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is not a schedule: {' '.join(str(error).split())}") from error
