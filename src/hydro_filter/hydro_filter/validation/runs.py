# SPDX-License-Identifier: Apache-2.0
"""Table val_cont: cases, their runs on a bench under a filter, and the runs' statistics.

A case is gains over time and a reference, by seed (paper, Learned Metric Validation). The emulator's plant is
identical, sample for sample, to the one behind the serial line, except for its clock. Nothing else in this package
imports the emulator.

Plant, box and filter run sample by sample without a graph, with the graph's delays::

    k:   tick(x_k) -> BenchState_k -> filter -> delta_u_k          plant holds u_k -> x_{k+1}
    k+1: receive(delta_u_k)  tick(x_{k+1})                         a correction acts one sample after its state

The plant's guard is in this loop, opened to the box's limits: the gains that a MISMATCH costs are part of the run.
Gains change at 100 Hz. A run ends if the box trips (700 N, sensor ranges), and is then not bounded.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cache
from math import nan
from typing import NamedTuple, Protocol

import numpy as np

from hydro_bridge.safety.guard import CommandGuard, GuardSettings
from hydro_core.signals import (
    SAMPLE_PERIOD,
    SAMPLES_PER_STEP,
    STATE_DTYPE,
    Command,
    CorrectionStatus,
    Flag,
    FloatArray,
    ReferenceSignal,
    StateArray,
    Waveform,
)
from hydro_filter.controller.factory import FilterChoice
from hydro_filter.controller.loop_filter import LoopFilter, LoopFilterSettings, Result
from hydro_filter.model.sample import Sample
from hydro_filter.validation.osqp_solver import Osqp
from hydro_sim.box.box import Box, BoxConfig
from hydro_sim.emulator.truth.config import profile
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.bench import NOMINAL, Bench
from hydro_sim.model.plant import Plant

PLANTS = ("emulator", "sim")


@cache  # kept in this process, as filters are
def plant_by_name(name: str, model: str | None = None) -> Plant:
    """Return one of `PLANTS`; `model`: bench file of the simulation, the shipped one by default."""
    return make_plant(model) if name == "sim" else TruthPlant(profile("default"))


SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=NOMINAL.force * 2.0 / 3.0, frequency=1.0)
FAST_SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=NOMINAL.force, frequency=2.0)


@dataclass(frozen=True)
class Case:
    """Validation case: gains over time, and the reference."""

    description: str
    proportional: tuple[float, float]
    """Range of K_p [1/s]."""
    integral: tuple[float, float]
    """Range of K_i [1/s^2]."""
    hold_steps: int = 0
    """Policy steps of 10 ms for which drawn gains are held; 0: the whole run."""
    switched: bool = False
    """K_p is at either end of its range in turn, from a random phase on, instead of drawn."""
    reference: ReferenceSignal = SINE

    def draw_gains(self, seed: int, seconds: float) -> FloatArray:
        """Return random gains of a run, shape (policy steps, 2)."""
        rng, steps = np.random.default_rng(seed), round(seconds / (SAMPLES_PER_STEP * SAMPLE_PERIOD))
        if self.switched:
            turns = (np.arange(steps) + int(rng.integers(2 * self.hold_steps))) // self.hold_steps % 2
            return np.column_stack([np.where(turns == 0, *self.proportional), np.full(steps, self.integral[0])])
        span = self.hold_steps or steps
        draws = -(-steps // span)
        pairs = np.column_stack([rng.uniform(*self.proportional, draws), rng.uniform(*self.integral, draws)])
        return np.repeat(pairs, span, axis=0)[:steps]


CASES: dict[str, Case] = {
    "stable": Case("K_p 90, K_i 15 (paper)", (90.0, 90.0), (15.0, 15.0)),
    "stable-fast": Case("the same, 300 N at 2 Hz", (90.0, 90.0), (15.0, 15.0), reference=FAST_SINE),
    "base": Case("K_p 15, K_i 5", (15.0, 15.0), (5.0, 5.0)),
    "unstable": Case("K_p -40 to 40, K_i -5 to 5, drawn every 10 ms (paper)", (-40.0, 40.0), (-5.0, 5.0), hold_steps=1),
    "unstable-slow": Case("the same, drawn every 0.5 s", (-40.0, 40.0), (-5.0, 5.0), hold_steps=50),
    "negative": Case("K_p -40 to 0, K_i -5 to 0, drawn every 10 ms", (-40.0, 0.0), (-5.0, 0.0), hold_steps=1),
    "negative-held": Case("the same, drawn once", (-40.0, 0.0), (-5.0, 0.0)),
    "positive": Case("K_p 0 to 40, K_i 0 to 5, drawn every 10 ms", (0.0, 40.0), (0.0, 5.0), hold_steps=1),
    "high": Case("K_p 100 to 300, K_i 5 to 15, drawn once", (100.0, 300.0), (5.0, 15.0)),
    "high-fast": Case("the same, 300 N at 2 Hz", (100.0, 300.0), (5.0, 15.0), reference=FAST_SINE),
    "highest": Case("K_p 300, K_i 15", (300.0, 300.0), (15.0, 15.0)),
    "wide": Case("K_p -40 to 300, K_i -5 to 15, drawn every 10 ms", (-40.0, 300.0), (-5.0, 15.0), hold_steps=1),
    "wide-slow": Case("the same, drawn every 0.5 s", (-40.0, 300.0), (-5.0, 15.0), hold_steps=50),
    "switched": Case(
        "K_p 15 and 300 in turn, each for 10 ms", (15.0, 300.0), (15.0, 15.0), hold_steps=1, switched=True
    ),
    "switched-slow": Case(
        "K_p 15 and 300 in turn, each for 0.5 s", (15.0, 300.0), (15.0, 15.0), hold_steps=50, switched=True
    ),
}


class Corrector(Protocol):
    """Interface of a filter: one correction for each sample."""

    def reset(self) -> None:
        """Reset to the initial state."""

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""


class Run(NamedTuple):
    """Recorded run, up to the sample at which the box tripped, if it did."""

    states: StateArray
    """Records of `STATE_DTYPE`, shape (samples,)."""
    results: list[Result]
    """One per sample."""

    @property
    def bounded(self) -> bool:
        """Whether the box never tripped (force limit, sensor range)."""
        return not int(self.states["flags"][-1]) & Flag.TRIPPED


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One closed-loop simulation."""

    bench: Bench
    """Bench assumed by box and filter."""
    reference: ReferenceSignal
    gains: FloatArray
    """K_p [1/s], K_i [1/s^2] in force at 100 Hz, shape (policy steps, 2)."""
    box: BoxConfig = field(default_factory=BoxConfig)
    """Settings of the box."""
    seed: int = 0
    """Of the plant's noise."""


def run(trial: Trial, plant: Plant, contraction_filter: Corrector) -> Run:
    """Simulate a trial; a filter with `bypass` set gives the loop without correction."""
    contraction_filter.reset()
    box, limits = Box(trial.bench, trial.box), trial.box
    # as wide as the box's limits, so that only the filter intervenes
    guard = CommandGuard(settings=replace(
        GuardSettings.of_size(trial.bench.size), delta_kp_min=limits.delta_kp_min, delta_kp_max=limits.delta_kp_max,
        delta_ki_min=limits.delta_ki_min, delta_ki_max=limits.delta_ki_max, delta_u_max=limits.delta_u_max,
        require_filter=False,
    ))  # fmt: skip
    guard.set_arm(True)
    guard.set_reference(trial.reference)
    changes = np.asarray(trial.gains) - (box.config.base_kp, box.config.base_ki)
    states = np.empty(len(changes) * SAMPLES_PER_STEP, STATE_DTYPE)
    results: list[Result] = []
    box.receive(Command(), 0.0)
    measurement = plant.reset(trial.seed)
    for k in range(len(states)):
        now = k * SAMPLE_PERIOD
        if k % SAMPLES_PER_STEP == 0:
            delta_kp, delta_ki = (float(change) for change in changes[k // SAMPLES_PER_STEP])
            guard.set_gains(delta_kp, delta_ki, now)
        box.receive(guard.command(now), now)
        states[k] = box.tick(measurement, now)
        results.append(contraction_filter.correct(Sample.from_record(states[k])))
        guard.add_sample(k)
        guard.set_correction(results[-1].delta_u, results[-1].status, k, now)
        if int(states["flags"][k]) & Flag.TRIPPED:
            return Run(states[: k + 1], results)
        measurement = plant.step(float(states["valve_current"][k]))
    return Run(states, results)


class Gammas(NamedTuple):
    """The paper's Table val_cont, with each share named after the samples it counts (physics.md, decisions)."""

    correction: float
    """gamma_1: mean |delta_u| over u_max."""
    violated_before: float
    """gamma_2: share of samples with M_c > 0 without the correction."""
    mean_before: float
    """gamma_3: mean M_c [1/s] without it."""
    violated_after: float
    """gamma_4: share with M_c > 0 under it."""
    mean_after: float
    """gamma_5: mean M_c [1/s] under it."""


def gammas(results: list[Result], current_max: float) -> Gammas:
    """Return gamma_1 to gamma_5 over all evaluated samples; M_c up to 1e-6/s counts as satisfied."""
    skipped = (CorrectionStatus.NAN, CorrectionStatus.STALE, CorrectionStatus.MISMATCH)
    table = np.array([result[:3] for result in results if result.status not in skipped] or [(nan, nan, nan)])
    correction, before, after = np.abs(table[:, 0]) / current_max, table[:, 1], table[:, 2]
    shares = (before > 1e-6).mean(), (after > 1e-6).mean()
    return Gammas(
        float(correction.mean()), float(shares[0]), float(before.mean()), float(shares[1]), float(after.mean())
    )


FILTERS = ("none", "learned")
"""none: bypassed, its certificate evaluated; learned: the default."""
UNRESTORED_STATUSES = (CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE, CorrectionStatus.NAN)
"""Statuses of a sample whose certificate could not be restored."""
SETTLING_SAMPLES = 2000
"""Samples left out of RMSE and chattering: the fade from rest."""


@dataclass(frozen=True, kw_only=True)
class Task:
    """Parameters of one run in plain types, for worker processes."""

    plant: str
    case: str
    filter: str
    seed: int
    seconds: float
    metric: str | None = None
    model: str | None = None
    bench: str | None = None

    @property
    def box_bench(self) -> Bench:
        """Bench that box and filter assume."""
        return Bench.load(self.bench) if self.bench else Bench.nominal()


@dataclass(frozen=True, kw_only=True, eq=False)
class Outcome:
    """Statistics of one run."""

    bounded: bool
    peak: float
    """N, largest |f_l|."""
    rmse: float
    """N, of f_r - f_l."""
    chattering: float
    """A/s, RMS of u'."""
    gammas: Gammas
    samples: int
    failed: int
    """Samples with a status of `UNRESTORED_STATUSES`."""
    agreed: int
    """Problems that OSQP solves as the filter does."""
    differed: int
    """Problems that OSQP does not solve as the filter does."""


class CheckedFilter:
    """Filter whose QPs are checked by OSQP."""

    def __init__(self, contraction_filter: LoopFilter) -> None:
        self._filter, self.osqp = contraction_filter, Osqp()

    def reset(self) -> None:
        """See `Corrector`."""
        self._filter.reset()
        self.osqp = Osqp()

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """See `Corrector`."""
        result = self._filter.correct(sample, age)
        if result.status in (CorrectionStatus.MODIFIED, CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE):
            self.osqp.compare(*self._filter.decision[["a", "b", "low", "high"]].item())
        return result


@cache
def make_filter(
    chosen: str, metric: str | None = None, model: str | None = None, bench: str | None = None
) -> CheckedFilter:
    """Return one of `FILTERS`; other arguments as in `Task`."""
    choice = FilterChoice.from_files(metric=metric, model=model, bench=bench)
    return CheckedFilter(choice.make(LoopFilterSettings(bypass=chosen == "none")))


def simulate(task: Task) -> Run:
    """Return the recorded run of a task."""
    case, bench = CASES[task.case], task.box_bench
    amplitude = case.reference.amplitude * bench.size.force / NOMINAL.force
    trial = Trial(
        bench=bench,
        reference=replace(case.reference, amplitude=amplitude),
        gains=case.draw_gains(task.seed, task.seconds),
        box=BoxConfig().of_bench(bench),
        seed=task.seed,
    )
    chosen = make_filter(task.filter, task.metric, task.model, task.bench)
    return run(trial, plant_by_name(task.plant, task.model), chosen)


def evaluate_task(task: Task) -> Outcome:
    """Run a task and compute its statistics."""
    done, osqp = simulate(task), make_filter(task.filter, task.metric, task.model, task.bench).osqp
    states, limit = done.states, task.box_bench.valve_current_max
    settled = states[min(SETTLING_SAMPLES, len(states) // 2) :]
    return Outcome(
        bounded=done.bounded, peak=float(np.abs(states["load_force"]).max()),
        rmse=tracking_rmse(settled), chattering=chattering(settled),
        gammas=gammas(done.results, limit), samples=len(states),
        failed=sum(result.status in UNRESTORED_STATUSES for result in done.results),
        agreed=osqp.agreed, differed=osqp.differed,
    )  # fmt: skip


def tracking_rmse(states: StateArray) -> float:
    """Return the RMSE of f_r - f_l [N]."""
    return float(np.sqrt(np.mean((states["reference_force"] - states["load_force"]) ** 2)))


def chattering(states: StateArray) -> float:
    """Return the RMS [A/s] of the valve current's rate."""
    return float(np.sqrt(np.mean((np.diff(states["valve_current"]) / SAMPLE_PERIOD) ** 2))) if len(states) > 1 else 0.0
