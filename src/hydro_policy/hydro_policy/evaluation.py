# SPDX-License-Identifier: Apache-2.0
"""Force RMSE of controllers on sines, run by run on a live plant; knows no ROS.

run       a new reference, 2 s to settle, then whole periods of at least 3 s in all over which e = f_r - f_l counts
order     repeat, frequency, controller: controllers follow each other closely, so a drifting bench treats them alike
failure   the box trips: the run counts as tripped. The plant is lost: the run is begun anew
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from hydro_bridge.settings import check
from hydro_bridge.signals import STATE_DTYPE, Flag, FloatArray, ReferenceSignal, StateArray, Waveform
from hydro_policy.controllers import Controller
from hydro_policy.outputs import Outputs
from hydro_policy.steps import HELD
from hydro_policy.task import SAMPLES_PER_STEP
from hydro_policy.watch import PlantWatch

SAMPLE_RATE = 1000.0  # Hz


@dataclass(frozen=True, kw_only=True)
class EvaluationSettings:
    """The paper's Table rmse by default."""

    frequencies: tuple[float, ...] = (0.5, 1.0, 1.5, 2.0)
    """Hz, each within 0.05 to 10."""
    amplitude: float = 300.0
    """N. [0, 1000]."""
    settle: float = 2.0
    """s left out at the start of each run. [0.5, 60]: the cross-fade takes 0.3 s."""
    measure: float = 3.0
    """s measured at least; rounded up to whole periods. [0.1, 600]."""
    repeats: int = 1
    """Runs of each controller at each frequency. [1, 1000]."""

    def __post_init__(self) -> None:
        check(self)
        if not self.frequencies or not all(0.05 <= f <= 10.0 for f in self.frequencies):
            raise ValueError(f"an evaluation needs frequencies between 0.05 and 10 Hz, not {self.frequencies}")

    def measured(self, frequency: float) -> float:
        """s measured at this frequency, whole periods."""
        return math.ceil(self.measure * frequency - 1e-9) / frequency


@dataclass(frozen=True, kw_only=True)
class Score:
    """One run."""

    controller: str
    frequency: float
    repeat: int
    rmse: float
    """N; NaN if it tripped."""
    peak: float
    """N, largest |e|; NaN if it tripped."""
    chatter: float
    """A/s, RMS of u'; NaN if it tripped."""
    proportional_gain: float
    """1/s, mean that the box applied."""
    integral_gain: float
    """1/s^2, mean that the box applied."""
    lost: int
    """Samples that never arrived."""
    held: int
    """Samples for which the box held base gains (stale correction or command)."""
    tripped: bool


@dataclass
class Trace:
    """The measured part of one run; time from 0."""

    controller: str
    frequency: float
    states: StateArray  # shape (n,)


@dataclass
class _Run:
    """What has been seen of the present run."""

    first: int = -1
    rows: list[tuple[float, ...]] = field(default_factory=list)


class EvaluationSession:
    """Drives all runs one after another.

    Parameters
    ----------
    settings
        Which sines, how long.
    controllers
        At least one.
    outputs
        The graph.
    rearm
        See `watch.PlantWatch`.
    """

    def __init__(
        self, settings: EvaluationSettings, controllers: list[Controller], outputs: Outputs, *, rearm: bool = True
    ) -> None:
        if not controllers:
            raise ValueError("an evaluation needs a controller")
        self.settings, self.watch = settings, PlantWatch(outputs, rearm)
        self.plan = [(r, f, c) for r in range(settings.repeats) for f in settings.frequencies for c in controllers]
        self.scores: list[Score] = []
        self.traces: list[Trace] = []
        self.warnings: list[str] = []
        self._outputs = outputs
        self._run: _Run | None = None
        self._steps = 0

    @property
    def finished(self) -> bool:
        """Whether all runs are scored."""
        return len(self.scores) == len(self.plan)

    @property
    def seconds(self) -> float:
        """Bench time of the whole plan."""
        return sum(self.settings.settle + self.settings.measured(f) for _, f, _ in self.plan)

    @property
    def seconds_done(self) -> float:
        """Bench time of the runs scored."""
        return sum(self.settings.settle + self.settings.measured(f) for _, f, _ in self.plan[: len(self.scores)])

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample [14]; True if it made a step."""
        self.watch.on_sample(flags, now)
        if self.finished:
            return False
        if not flags & Flag.ARMED:
            if self._run is not None and flags & Flag.TRIPPED:
                self._score_trip()
            self._run = None
            return False
        if self._run is None:
            self._run = self._begin(sequence)
        self._collect(self._run, sequence, sample, flags)
        _, _, controller = self.plan[len(self.scores)]
        if sequence % SAMPLES_PER_STEP:
            return self._end_if_due(self._run, sequence)
        self._outputs.gains(*controller.gains(sample), self._steps)
        self._steps += 1
        self._end_if_due(self._run, sequence)
        return True

    def on_tick(self, now: float) -> None:
        """Some twenty times a second."""
        self.watch.on_tick(now)
        if self.watch.lost and self._run is not None:
            self._run = None
            self._outputs.say("no samples: this run is begun anew", warning=True)

    def _begin(self, sequence: int) -> _Run:
        _, frequency, controller = self.plan[len(self.scores)]
        controller.reset()
        self._outputs.reference(
            ReferenceSignal(waveform=Waveform.SINE, amplitude=self.settings.amplitude, frequency=frequency)
        )
        return _Run(first=sequence)

    def _collect(self, run: _Run, sequence: int, sample: FloatArray, flags: int) -> None:
        if sequence - run.first >= self.settings.settle * SAMPLE_RATE:
            time = (sequence - run.first) / SAMPLE_RATE - self.settings.settle
            run.rows.append((time, sequence, *sample, flags))

    def _end_if_due(self, run: _Run, sequence: int) -> bool:
        """End the run when its time is over; always False (no policy step was made here)."""
        repeat, frequency, controller = self.plan[len(self.scores)]
        length = self.settings.settle + self.settings.measured(frequency)
        if sequence - run.first + 1 >= round(length * SAMPLE_RATE) and run.rows:
            trace = Trace(controller.name, frequency, np.array(run.rows, STATE_DTYPE))
            self._check_gains(controller, trace)
            self._check_held(trace)
            self.scores.append(_score(trace, repeat))
            self.traces.append(trace)
            self._run = None
        return False

    def _score_trip(self) -> None:
        repeat, frequency, controller = self.plan[len(self.scores)]
        nothing = dict.fromkeys(("rmse", "peak", "chatter", "proportional_gain", "integral_gain"), math.nan)
        self.scores.append(
            Score(
                controller=controller.name, frequency=frequency, repeat=repeat, lost=0, held=0, tripped=True, **nothing
            )
        )
        self._outputs.say(f"{controller.name} at {frequency:g} Hz: {self.watch.condition}", warning=True)

    def _check_held(self, trace: Trace) -> None:
        """Base gains instead of the controller's, for more than one sample in a hundred, is no fair comparison."""
        held = float(np.mean((trace.states["flags"] & HELD) != 0))
        if held > 0.01:
            sentence = f"{trace.controller} at {trace.frequency:g} Hz: base gains in {100 * held:.0f} % of the samples"
            self._warn(f"{sentence}, corrections came late (machine too busy?)")

    def _check_gains(self, controller: Controller, trace: Trace) -> None:
        """A guard narrower than the controller would silently compare something else."""
        asked = getattr(controller, "proportional", None)
        applied = float(np.median(trace.states["proportional_gain"]))
        if asked is not None and abs(asked - applied) > 1e-3 * max(abs(asked), 1.0):
            sentence = (
                f"{controller.name}: the box applied K_p = {applied:g}, not {asked:g}; widen the plant's gain limits"
            )
            self._warn(sentence)

    def _warn(self, sentence: str) -> None:
        if sentence not in self.warnings:
            self.warnings.append(sentence)
            self._outputs.say(sentence, warning=True)


def _score(trace: Trace, repeat: int) -> Score:
    states = trace.states
    error = states["reference_force"] - states["load_force"]
    steps = np.diff(states["sequence"].astype(np.int64))
    current_rate = np.diff(states["valve_current"]) / steps * SAMPLE_RATE
    return Score(
        controller=trace.controller,
        frequency=trace.frequency,
        repeat=repeat,
        rmse=float(np.sqrt(np.mean(error**2))),
        peak=float(np.abs(error).max()),
        chatter=float(np.sqrt(np.mean(current_rate**2))),
        proportional_gain=float(states["proportional_gain"].mean()),
        integral_gain=float(states["integral_gain"].mean()),
        lost=int((steps - 1).sum()),
        held=int(np.count_nonzero(states["flags"] & HELD)),
        tripped=False,
    )
