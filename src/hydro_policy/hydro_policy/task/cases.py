# SPDX-License-Identifier: Apache-2.0
"""Cases of an evaluation (references to track), their settings, and the scores of its runs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from hydro_core.settings import SettingsError, check, quantity
from hydro_core.signals import FADE_TIME, SAMPLE_PERIOD, FloatArray, ReferenceSignal, StateArray, Waveform
from hydro_policy.task import recorded
from hydro_sim.model.bench import NOMINAL

K = TypeVar("K")


@dataclass(frozen=True)
class Case:
    """Evaluation case: a reference to track, measured over whole periods (of a multisine: of its slowest sine)."""

    name: str  # name for tables: `2 Hz`, `multisine`, `steps`
    signal: ReferenceSignal
    segments: tuple[ReferenceSignal, ...] = ()
    """Signals that follow `signal`, one every 0.3 s: a recorded reference (`task.recorded`), played to its end."""

    def signal_due(self, before: int, now: int) -> ReferenceSignal | None:
        """Return the signal to send at sample `now` of a run; None: none. `before`: the previous sample's number."""
        number = now // recorded.SEGMENT_SAMPLES
        due = before // recorded.SEGMENT_SAMPLES < number and 0 < number <= len(self.segments)
        return self.segments[number - 1] if due else None


FAST_SINES = {5.0: 1.0 / 3.0, 10.0: 1.0 / 6.0}
"""Fast sines, beyond the paper's: frequency [Hz] and share of the amplitude, 100 and 50 N on the nominal bench.

The flow at full current is the limit: A v = q_n sqrt(2 p_s / (1 + alpha^3) / dp_n) gives k v / (2 pi f), 1020 and 510 N
on the nominal bench, 310 and 150 N with the softest spring, weakest valve and lowest supply that the benchmarks draw.
The amplitudes are a third of the latter, a margin for the law's phase lead and for the load cell's lag.
"""


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings:
    """Cases, lengths and repeats of an evaluation; by default those of the paper's Table rmse."""

    frequencies: tuple[Annotated[float, quantity("Hz", 0.05, 10.0)], ...] = (0.5, 1.0, 1.5, 2.0)
    """Of the sines."""
    amplitude: Annotated[float, quantity("N", 0.0, 1e7)] = NOMINAL.force
    """Of sines and multisine."""
    multisine: bool = False
    """Four incommensurate sines from 0.5 Hz up, at most `amplitude` together, too."""
    steps: bool = False
    """Smooth steps of two thirds of `amplitude` to both sides at 0.5 Hz, too."""
    fast: bool = False
    """Sines of 5 Hz with a third of `amplitude` and of 10 Hz with a sixth, too."""
    recorded: tuple[str, ...] = ()
    """Files of recorded references, CSV, .mat or bag, scaled to `amplitude`, too."""
    settle: Annotated[float, quantity("s", 0.5, 60.0)] = 2.0
    """Left out at the start of each run: the cross-fade takes 0.3 s."""
    measure: Annotated[float, quantity("s", 0.1, 600.0)] = 3.0
    """Measured at least; rounded up to whole periods."""
    periods: Annotated[int, quantity("-", 1, 1000)] = 1
    """Periods measured at least."""
    repeats: Annotated[int, quantity("-", 1, 1000)] = 1
    """Runs of each controller at each case."""

    def __post_init__(self) -> None:
        check(self)
        if not self.cases:
            raise SettingsError("an evaluation needs frequencies, a multisine or steps")

    @property
    def cases(self) -> tuple[Case, ...]:
        """All cases, in order of evaluation."""
        signals = [(f"{f:g} Hz", Waveform.SINE, self.amplitude, f) for f in self.frequencies]
        if self.multisine:
            signals.append(("multisine", Waveform.MULTISINE, self.amplitude, 0.5))
        if self.steps:
            signals.append(("steps", Waveform.SMOOTH_STEP, self.amplitude * 2.0 / 3.0, 0.5))
        for frequency, share in FAST_SINES.items() if self.fast else ():
            force = self.amplitude * share
            signals.append((f"{frequency:g} Hz, {force:g} N", Waveform.SINE, force, frequency))
        cases = [Case(name, ReferenceSignal(waveform=w, amplitude=a, frequency=f)) for name, w, a, f in signals]
        for file in self.recorded:
            first, *others = recorded.segments(Path(file), self.amplitude)
            cases.append(Case(Path(file).stem, first, tuple(others)))
        return tuple(cases)

    def measured_time(self, case: Case) -> float:
        """Return the measured time [s]: whole periods; of a recorded reference its length without `settle`."""
        if case.segments:
            return max(FADE_TIME * (len(case.segments) + 1) - self.settle, self.measure)
        frequency = case.signal.frequency
        return max(math.ceil(self.measure * frequency - 1e-9), self.periods) / frequency

    def duration(self, case: Case) -> float:
        """Return the duration of a run [s]."""
        return self.settle + self.measured_time(case)


@dataclass(frozen=True, kw_only=True)
class ExamSettings:
    """Settings of an examination: evaluation of the policy's mean action on the paper's sines between episodes."""

    every: Annotated[int, quantity("-", 0, 1e6, "Episodes between two, one more before and after; 0: none")] = 4
    settle: Annotated[float, quantity("s", 0.5, 60.0, "Left out at the start of each sine, as in an evaluation")] = 2.0
    measure: Annotated[float, quantity("s", 0.1, 600.0, "Measured at least of each sine, in whole periods")] = 2.0
    amplitude: Annotated[float, quantity("N", 0.0, 1e7, "Of the sines")] = NOMINAL.force
    repeats: Annotated[
        int, quantity("-", 1, 20, "Runs of each sine; their scatter is what a better policy must beat; 1: any counts")
    ] = 2
    reference_kp: Annotated[float, quantity("1/s", 0.0, 500.0, "K_p that scores are relative to (paper's III)")] = 90.0
    reference_ki: Annotated[float, quantity("1/s^2", 0.0, 500.0, "K_i of the same")] = 15.0

    @property
    def evaluation(self) -> EvaluationSettings:
        """Evaluation settings of an examination."""
        return EvaluationSettings(
            amplitude=self.amplitude, settle=self.settle, measure=self.measure, repeats=self.repeats
        )


DISTURBED_SHARE_MAX = 0.01
"""Largest share of a run's samples that may be lost, or under base gains, for its figures to be valid."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Score of one evaluation run: force RMSE and further figures, or the reason of a stop."""

    controller: str
    case: str  # name of the reference
    frequency: float  # frequency of the reference [Hz] (of a multisine: its slowest sine)
    repeat: int
    rmse: float = math.nan  # force RMSE [N]; NaN if the run was stopped
    reference_rms: float = math.nan  # N, RMS of the reference
    true_rmse: float = math.nan
    """N, RMSE of the force on the specimen, in front of the load cell; NaN unless the plant is emulated."""
    peak: float = math.nan  # N, largest |e|
    chatter: float = math.nan  # A/s, RMS of u'
    proportional_gain: float = math.nan  # 1/s, mean that the box applied
    integral_gain: float = math.nan  # 1/s^2, mean that the box applied
    samples: int = 0  # samples that were measured
    lost: int = 0
    """Lost samples: sequence numbers of the measured part that never arrived. The name is a key of recorded events."""
    held: int = 0
    """Samples under base gains in place of the controller's, with a stale correction or command. A key, as `lost`."""
    stopped: str = ""  # why the run was not completed: the box tripped, or the monitor stopped it; empty if it was

    @classmethod
    def of_event(cls, event: Mapping[str, Any]) -> Score:
        """Return the score stored in an event of a run's record, where NaN is null."""
        values: dict[str, Any] = {
            one.name: math.nan if event[one.name] is None else event[one.name] for one in fields(cls)
        }
        return cls(**values)

    @property
    def run(self) -> tuple[str, str, int]:
        """Key of the run: controller, reference, repeat."""
        return self.controller, self.case, self.repeat

    @property
    def disturbed(self) -> bool:
        """Whether the share of lost samples and of those under base gains exceeds `DISTURBED_SHARE_MAX`.

        In records and files it has the key `spoilt`.
        """
        return self.lost + self.held > DISTURBED_SHARE_MAX * (self.samples + self.lost)


@dataclass
class Trace:
    """Samples of the measured part of one run; time from 0."""

    controller: str
    case: str
    frequency: float
    states: StateArray  # shape (n,)


def score(trace: Trace, repeat: int, held: int = 0, specimen_force: FloatArray | None = None) -> Score:
    """Compute the score of a completed run; `specimen_force`: force on the specimen [N], shape (n,), if it is known."""
    states = trace.states
    error = states["reference_force"] - states["load_force"]
    steps = np.diff(states["sequence"].astype(np.int64))
    current_rate = np.diff(states["valve_current"]) / (steps * SAMPLE_PERIOD)
    true_rmse = math.nan
    if specimen_force is not None:
        true_rmse = float(np.sqrt(np.mean((states["reference_force"] - specimen_force) ** 2)))
    return Score(
        controller=trace.controller,
        case=trace.case,
        frequency=trace.frequency,
        repeat=repeat,
        rmse=float(np.sqrt(np.mean(error**2))),
        reference_rms=float(np.sqrt(np.mean(states["reference_force"] ** 2))),
        true_rmse=true_rmse,
        peak=float(np.abs(error).max()),
        chatter=float(np.sqrt(np.mean(current_rate**2))),
        proportional_gain=float(states["proportional_gain"].mean()),
        integral_gain=float(states["integral_gain"].mean()),
        samples=len(states),
        lost=int((steps - 1).sum()),
        held=held,
    )


def relative_scores(rmse: Mapping[K, ArrayLike]) -> dict[K, float]:
    """Return each entry's mean over the references of its RMSE relative to the smallest RMSE on that reference.

    `rmse`: RMSE [N] of each entry on the same references, non-finite for a stopped run. Entries with a stopped run are
    left out, also of the smallest.
    """
    arrays = {key: np.asarray(values, float) for key, values in rmse.items()}
    whole = {key: values for key, values in arrays.items() if np.isfinite(values).all()}
    smallest = np.min(list(whole.values()), axis=0) if whole else 1.0
    return {key: float(np.mean(values / smallest)) for key, values in whole.items()}
