# SPDX-License-Identifier: Apache-2.0
"""What controllers are compared on: the paper's sines, and references that no policy was trained on."""

from __future__ import annotations

import math
from dataclasses import dataclass

from hydro_bridge.settings import check
from hydro_bridge.signals import ReferenceSignal, Waveform


@dataclass(frozen=True)
class Case:
    """A reference to track; a whole number of periods is measured (of a multisine, which has none: of its slowest)."""

    name: str
    """For tables: `2 Hz`, `multisine`, `steps`."""
    signal: ReferenceSignal


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings:
    """The paper's Table rmse by default."""

    frequencies: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)
    """Hz, each within 0.05 to 10."""
    amplitude: float = 300.0
    """N, of sines and multisine. [0, 1000]."""
    multisine: bool = False
    """Four incommensurate sines from 0.5 Hz up, at most `amplitude` together, too."""
    steps: bool = False
    """Smooth steps of 200 N to both sides at 0.5 Hz, too."""
    settle: float = 2.0
    """s left out at the start of each run. [0.5, 60]: the cross-fade takes 0.3 s."""
    measure: float = 3.0
    """s measured at least; rounded up to whole periods. [0.1, 600]."""
    periods: int = 1
    """Periods measured at least. [1, 1000]."""
    repeats: int = 1
    """Runs of each controller at each case. [1, 1000]."""

    def __post_init__(self) -> None:
        check(self)
        known = all(0.05 <= f <= 10.0 for f in self.frequencies)
        if not known or not (self.frequencies or self.multisine or self.steps):
            raise ValueError(f"an evaluation needs frequencies between 0.05 and 10 Hz, not {self.frequencies}")

    @property
    def cases(self) -> tuple[Case, ...]:
        """All that is run, in this order."""
        cases = [Case(f"{f:g} Hz", _signal(Waveform.SINE, self.amplitude, f)) for f in self.frequencies]
        if self.multisine:
            cases.append(Case("multisine", _signal(Waveform.MULTISINE, self.amplitude, 0.5)))
        if self.steps:
            cases.append(Case("steps", _signal(Waveform.SMOOTH_STEP, 200.0, 0.5)))
        return tuple(cases)

    def measured(self, frequency: float) -> float:
        """s measured at this frequency [Hz], whole periods."""
        return max(math.ceil(self.measure * frequency - 1e-9), self.periods) / frequency

    def length(self, case: Case) -> float:
        """s that a run takes."""
        return self.settle + self.measured(case.signal.frequency)


@dataclass(frozen=True, kw_only=True)
class ExamSettings:
    """The examination of a policy between training episodes: its mean action on the paper's sines, nothing learnt."""

    every: int = 4
    """Training episodes between two examinations, one before the first and one at the end; 0: none. [0, 1e6]."""
    settle: float = 2.0
    """s left out at the start of each sine, as in an evaluation. [0.5, 60]."""
    measure: float = 2.0
    """s measured at least of each sine; rounded up to whole periods. [0.1, 600]."""
    reference_kp: float = 90.0
    """1/s, K_p of the fixed gains that scores are relative to (the paper's III). [0, 500]."""
    reference_ki: float = 15.0
    """1/s^2, K_i of the same. [0, 500]."""

    @property
    def evaluation(self) -> EvaluationSettings:
        """What is run."""
        return EvaluationSettings(settle=self.settle, measure=self.measure)


def _signal(waveform: Waveform, amplitude: float, frequency: float) -> ReferenceSignal:
    return ReferenceSignal(waveform=waveform, amplitude=amplitude, frequency=frequency)
