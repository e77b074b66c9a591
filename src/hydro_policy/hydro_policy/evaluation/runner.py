# SPDX-License-Identifier: Apache-2.0
"""Trial runner: runs the trials of a plan one after another on a live plant, independent of ROS.

trial     a new reference, settling, then measurement of e = f_r - f_l; or a training episode of a number of policy
          steps under an exploring controller (`exploration`)
failure   the box trips, or the monitor requests a stop: the trial counts as stopped, and a second of recovery follows
pause     the plant is lost, disarmed, or overridden: the trial restarts. An episode continues under an override
unstable  the box trips at once under base gains, several times: all trials under this force law count as stopped
disturbed corrections, commands or samples came late, or the box tripped without commands: the trial restarts,
          `REPEATS_MAX` times at most
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from enum import IntEnum
from math import inf
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from hydro_core.signals import FAULT_FLAGS, SAMPLE_PERIOD, SAMPLES_PER_STEP, STATE_DTYPE, Flag, FloatArray, Law
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.evaluation.exploration import Explorer
from hydro_policy.evaluation.trial import Plan, Trial
from hydro_policy.runs.run_directory import RunRecord
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import (
    BASE_GAINS_UNSTABLE_MESSAGE,
    FALLBACK_GAIN_CHANGES,
    TRIPS_MAX,
    PlantSupervisor,
)
from hydro_policy.task.cases import DISTURBED_SHARE_MAX, Score, Trace, score
from hydro_policy.task.mdp import LOAD_FORCE, REFERENCE, REFERENCE_RATE, Step, StepClock, hold_flags
from hydro_sim.files import load_force

REPEATS_MAX = 2  # largest number of restarts of a disturbed trial

WATCHDOG_TRIP_MESSAGE = "the box heard nothing for too long and tripped: the machine was held up"
BASE_GAINS_SHARE_MAX = 0.5  # share of samples under base gains above which a run is no measurement of its controller


@dataclass
class _Run:
    """State of the running trial."""

    trial: Trial
    first: int
    last: int  # sequence of the last sample
    missed: int = 0  # samples that did not arrive
    rows: list[tuple[float, ...]] = field(default_factory=list)
    clock: StepClock = field(default_factory=StepClock)  # of its own steps: the one in which it begins is not whole


class Rest:
    """Session at rest, finished after `seconds` s disarmed with all requirements of `supervisor` met; arms nothing."""

    def __init__(self, seconds: float, supervisor: PlantSupervisor) -> None:
        self.supervisor, self.override, self.finished = supervisor, supervisor.override, False
        self._seconds, self._since = seconds, inf

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Process a sample; returns False: no gains are published."""
        self.supervisor.on_sample(flags, now)
        at_rest = self.supervisor.readiness.complete and not flags & Flag.ARMED
        self._since = min(self._since, now) if at_rest else inf
        self.finished = now - self._since >= self._seconds
        return False

    def on_correction(self, after: float, status: int) -> None:
        """Pass the filter's status on."""
        self.supervisor.on_correction(status)

    def on_tick(self, now: float) -> None:
        """Check the requirements for arming."""
        self.supervisor.readiness.check(now)


class Phase(IntEnum):
    """Phase of a session, with the values of `TrainingStatus.phase`."""

    WAITING = 0
    TRAINING = 1
    EVALUATING = 2
    PAUSED = 3
    FINISHED = 4


P = TypeVar("P", bound=Plan)


class TrialRunner(Generic[P]):
    """Runner of a plan's trials on a live plant; a session of the node.

    `plan`: plan of the trials. `supervisor`: supervisor of the plant. `monitor`: safety monitor, to stop a trial before
    the box trips; None: none. `compensation`: online estimator for controllers under the compensated law, if there are
    any. `load_force_file`: file of the forces on an emulated load (`hydro_sim.files.load_force`), if there is one.
    `record`, `kind`: record of the scores, except those of a training, as events of this kind. Scores in it from an
    interrupted run are reused, and their trials skipped.
    """

    def __init__(
        self,
        plan: P,
        supervisor: PlantSupervisor,
        *,
        monitor: SafetyMonitor | None = None,
        compensation: LiveCompensation | None = None,
        load_force_file: Path | None = None,
        record: RunRecord | None = None,
        kind: str = "trial",
    ) -> None:
        self.plan, self.supervisor, self.override = plan, supervisor, supervisor.override
        self.compensation, self.monitor = compensation, monitor
        self.scores: list[Score] = []
        self.traces: list[Trace] = []
        self.warnings: list[str] = []
        self.clock = StepClock()
        self._wrong_law, self._law_armings = False, 0
        self._outputs, self._load_force_file = supervisor.outputs, load_force_file
        self._repeats = 0
        self._run: _Run | None = None
        self._phase = Phase.WAITING
        self._steps, self._step_ended = 0, False
        self._record, self._kind = None, kind
        for event in record.events_of_interrupted(kind) if record is not None else ():
            made, due = Score.of_event(event), plan.trial
            same = due is not None and due.empty_score().run == made.run
            if not same:
                break
            self._add(made)
        self._record = record

    @property
    def finished(self) -> bool:
        """Whether all trials of the plan are completed."""
        return self.plan.trial is None

    @property
    def phase(self) -> Phase:
        """Phase of the session, as published on /hydro/training."""
        return Phase.FINISHED if self.finished else self._phase

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Process a sample, shape (14,); returns whether gains were published."""
        self.supervisor.on_sample(flags, now)
        if self.compensation is not None and (trial := self.plan.trial) is not None:
            self._follow_law(trial, self.compensation, sequence, sample, flags, now)
        if (trial := self.plan.trial) is None:
            return False
        step = self.clock.add(sequence, sample, flags, self._base(trial.controller))
        step_ended, self._step_ended = self._step_ended, step is not None and bool(flags & Flag.ARMED)
        if self.plan.training and (step is not None or not flags & Flag.ARMED):
            self.plan.prepare_step(synchronous=bool(flags & Flag.PACED))
        if not flags & Flag.ARMED:
            run = self._run
            if flags & Flag.TRIPPED:
                self._on_trip(flags, sample)
            self._pause(run, self.supervisor.condition)
            return False
        compensated = self.compensation is not None and self.compensation.acting is Law.COMPENSATED
        if (held := self.override.gains(now)) is not None:
            if self.compensation is not None and compensated:  # changes of the gains of the law that acts
                base, law = self.override.base, self.compensation.law
                held = base[0] + held[0] - law.base_kp, base[1] + held[1] - law.base_ki
            return self._hold(trial, held, sequence, step)
        if self.supervisor.mismatched and not self.supervisor.recovering and not self.supervisor.blocking_reason(now):
            self.supervisor.note_action(now)
            gains = (0.0, 0.0) if compensated else FALLBACK_GAIN_CHANGES  # as the guard passes them
            return self._hold(trial, gains, sequence, step)
        if self._run is None:
            if not self.supervisor.may_start(now):
                self._step_ended = False
                return self.supervisor.recovering and self._hold(trial, (0.0, 0.0), sequence, step)
            step_begins = step is not None if isinstance(trial.controller, Explorer) else step_ended
            if self.plan.training and not step_begins:
                return False
            self._run = self._begin(trial, sequence)
        elif isinstance(self._run.trial.controller, Explorer) and self.supervisor.blocking_reason(now):
            return False  # a person has held the gains: the plant is disarmed, and the episode is begun again
        self.supervisor.note_action(now)
        run, explorer = self._run, self._run.trial.controller
        if not isinstance(explorer, Explorer):
            self._measure(run, sequence, sample, flags)
        elif step is not None:
            reason = None if self.monitor is None else self.monitor.add(step)
            if reason is not None:
                self._stop(run.trial, reason, sample)
            else:
                explorer.act(step)
            if explorer.current.steps >= explorer.task.steps_per_episode and self._run is run:
                self._end(run)
        else:
            return False
        due = self.plan.trial
        if (
            self._run is None
            and due is not None
            and isinstance(due.controller, Explorer)
            and not self.supervisor.recovering
        ):
            self._run = self._begin(due, sequence)  # its first step is the next one
        return step is not None

    def _hold(self, trial: Trial, gains: tuple[float, float], sequence: int, step: Step | None) -> bool:
        """Publish gains that are not the controller's: an episode continues, any other trial restarts afterwards."""
        if isinstance(trial.controller, Explorer):
            if step is not None:
                trial.controller.override_gains(gains, step, under_way=self._run is not None)
                if self.monitor is not None:
                    self.monitor.reset()  # it assesses policies
            return step is not None
        self._run = None
        return sequence % SAMPLES_PER_STEP == 0 and self._publish(gains)

    def _pause(self, run: _Run | None, why: str) -> None:
        """Interrupt the running trial, which restarts later; nothing if there was none."""
        self._run = None
        if run is None:
            return
        again, self._phase = self.plan.trial is run.trial, Phase.PAUSED  # else it has been stopped, too
        where, explorer = run.trial.name, run.trial.controller
        if isinstance(explorer, Explorer):
            where = f"{run.trial.case.name} at step {explorer.current.steps}"
            explorer.discard_action()
        self.plan.pause()
        if again:
            self._outputs.report(f"paused in {where}: {why}; it starts again once the plant is armed", warning=True)

    def _follow_law(
        self, trial: Trial, compensation: LiveCompensation, sequence: int, sample: FloatArray, flags: int, now: float
    ) -> None:
        """Command the force law of the present or next controller; a plant armed with another is disarmed first.

        Under an override the law is left unchanged. Trials under a law that the plant does not adopt count as stopped.
        """
        law = trial.controller.law
        excluded = self._run is None or law.law is Law.PAPER or self.supervisor.mismatched
        force, rate = float(sample[LOAD_FORCE]), float(sample[REFERENCE_RATE])
        compensation.on_sample(sequence, force, flags, rate, reference=float(sample[REFERENCE]), excluded=excluded)
        wrong = bool(flags & Flag.ARMED) and compensation.acting is not law.law
        self._law_armings += wrong and not self._wrong_law
        self._law_armings *= wrong or not flags & Flag.ARMED
        self._wrong_law = wrong
        if self._law_armings > 3:
            self._give_up_law(law.law, "the plant does not take up the force law that is commanded")
        elif wrong and self.override.gains(now) is None:
            self._run = None
            self.supervisor.block_runs("the next controller needs another force law: it is armed with that")
        elif not wrong and sequence % SAMPLES_PER_STEP == 0:
            self._outputs.publish_law(law, self._steps)

    def _give_up_law(self, law: Law, why: str) -> None:
        """Score the plan's remaining trials under this force law, which come next, as stopped."""
        self._outputs.report(f"{why}: what is left under the {law.name.lower()} law is left out", warning=True)
        while (trial := self.plan.trial) is not None and trial.controller.law.law is law:
            self._add(trial.empty_score(why))
        self._run = None

    def on_tick(self, now: float) -> None:
        """Handle a tick, some twenty times a second."""
        self.supervisor.on_tick(now)
        if self.supervisor.lost:
            self._pause(self._run, "no samples")
        if warning := self.plan.poll():
            self._outputs.report(warning, warning=True)

    def on_correction(self, after: float, status: int) -> None:
        """Process the filter's result for a sample: M_c [1/s] under its correction, and the status."""
        self.supervisor.on_correction(status)
        if self.monitor is not None:
            self.monitor.on_correction(after, status)

    def _begin(self, trial: Trial, sequence: int) -> _Run:
        self.plan.prepare_trial(trial)
        self._phase = Phase.TRAINING if isinstance(trial.controller, Explorer) else Phase.EVALUATING
        trial.controller.reset()
        compensated = trial.controller.law.law is not Law.PAPER
        frozen = "A person had frozen the coefficients of the compensated law."
        if compensated and self.compensation and self.compensation.frozen and frozen not in self.warnings:
            self.warnings.append(frozen)
        if self.monitor is not None:
            self.monitor.reset()
        self._outputs.publish_reference(trial.case.signal)
        return _Run(trial, sequence, sequence - 1)

    def _measure(self, run: _Run, sequence: int, sample: FloatArray, flags: int) -> None:
        trial = run.trial
        before = (run.last - run.first) % 2**32
        run.missed, run.last = run.missed + (sequence - run.last - 1) % 2**32, sequence
        time = (sequence - run.first) * SAMPLE_PERIOD - trial.settle
        if time >= 0.0 and trial.is_scored:
            run.rows.append((time, sequence, *sample, flags))
        step = run.clock.add(sequence, sample, flags, self._base(trial.controller))
        reason = self.monitor.add(step) if step is not None and self.monitor is not None else None
        if reason is not None:
            self._publish((0.0, 0.0))
            self._stop(trial, reason, sample)
        elif sequence % SAMPLES_PER_STEP == 0:
            self._publish(trial.controller.gains(sample))
        if (signal := trial.case.signal_due(before, (sequence - run.first) % 2**32)) is not None:
            self._outputs.publish_reference(signal)
        if self._run is run and time >= 0.0 and time + SAMPLE_PERIOD >= trial.measure - 1e-9:
            self._end(run)

    def _publish(self, gains: tuple[float, float]) -> bool:
        self._outputs.publish_gains(*gains, self._steps)
        self._steps += 1
        return True

    def _end(self, run: _Run) -> None:
        trial, self._run = run.trial, None
        controller, case = trial.controller, trial.case
        if not trial.is_scored:
            self._add(trial.empty_score())
            return
        trace = Trace(controller.name, case.name, case.signal.frequency, np.array(run.rows, STATE_DTYPE))
        flags, k_p, k_i = (trace.states[name] for name in ("flags", "proportional_gain", "integral_gain"))
        bits, asked = hold_flags(flags, k_p, k_i, self._base(controller)), controller.fixed
        if asked is not None and asked == self._base(controller):
            bits = np.zeros_like(bits)  # base gains replace none but themselves
        share = float(np.mean(bits != 0))
        missed, late = run.missed / (run.last - run.first + 1), ""
        if share > DISTURBED_SHARE_MAX:
            what = "corrections" if controller.law.law is Law.PAPER else "commands of the law"
            late = f"base gains in {100 * share:.0f} % of the samples, {what} came late: close other programs"
        elif missed > DISTURBED_SHARE_MAX:  # the estimator of an adapted law excludes these
            late = f"{100 * missed:.0f} % of the samples did not arrive: close other programs"
        if late and share <= BASE_GAINS_SHARE_MAX and self._again(trial, late):
            return
        acted = float(np.median(k_p)), float(np.median(k_i))
        if asked is None or not np.allclose(acted, np.array(asked, float), rtol=1e-3, atol=1e-3):
            if share > BASE_GAINS_SHARE_MAX:
                self._leave_out(
                    trial, f"base gains acted in {100 * share:.0f} % of the samples: see the filter on /diagnostics"
                )
                return
            if asked is not None:
                gains = "K_p = {:g} and K_i = {:g} acted".format(*acted)
                self._leave_out(trial, f"{gains}: widen the plant's gain limits (guard.delta_kp_max)")
                return
        if late and (warning := f"{trial.name}: {late}") not in self.warnings:
            self.warnings.append(warning)
            self._outputs.report(warning, warning=True)
        file, sequences = self._load_force_file, trace.states["sequence"]
        specimen_force = None if file is None else load_force.read_forces(file, sequences)
        if not self.plan.training:
            self.traces.append(trace)
        self._add(score(trace, trial.repeat, int(np.count_nonzero(bits)), specimen_force))

    def _add(self, done: Score) -> str:
        self._repeats = 0
        if not self.plan.training:
            self.scores.append(done)
            if self._record is not None:
                self._record.add(self._kind, **asdict(done))
        return self.plan.add(done)

    def _again(self, trial: Trial, why: str) -> bool:
        """Repeat a disturbed trial; returns False if it has been repeated `REPEATS_MAX` times."""
        if self._repeats == REPEATS_MAX:
            return False
        self._repeats += 1
        self._outputs.report(f"{trial.name} is started again: {why}", warning=True)
        return True

    def _stop(self, trial: Trial, reason: str, sample: FloatArray) -> None:
        if isinstance(trial.controller, Explorer):
            trial.controller.terminate(sample)
            trial.controller.override_gains((0.0, 0.0))
        self._leave_out(trial, reason)
        self.supervisor.start_recovery()
        self._run, self._phase = None, Phase.PAUSED

    def _leave_out(self, trial: Trial, reason: str) -> None:
        """Score a trial as stopped."""
        told = self._add(trial.empty_score(reason)) or f"{trial.name}: {reason}"
        self._outputs.report(told, warning=True)

    def _on_trip(self, flags: int, sample: FloatArray) -> None:
        """Attribute a trip to the running trial, except under an override, or after late samples or commands."""
        silent, run = not flags & FAULT_FLAGS, None if self.override.active else self._run
        if run is not None and not (silent and (self.plan.training or self._again(run.trial, WATCHDOG_TRIP_MESSAGE))):
            self._stop(run.trial, WATCHDOG_TRIP_MESSAGE if silent else self.supervisor.condition, sample)
        elif self.supervisor.trips >= TRIPS_MAX and not self.plan.training and (trial := self.plan.trial) is not None:
            self.supervisor.trips = 0
            self._give_up_law(trial.controller.law.law, BASE_GAINS_UNSTABLE_MESSAGE)
        elif not self.supervisor.recovering and (self.override.active or not self.plan.training):
            self.supervisor.start_recovery()

    def _base(self, controller: Controller) -> tuple[float, float] | None:
        """Return the base gains of `hold_flags`; None under the compensated law, whose late commands are flagged."""
        return self.override.base if controller.law.law is Law.PAPER and not self.supervisor.mismatched else None


Session = Rest | TrialRunner[Any]
"""Session types: objects that process the plant's samples and command it, one at a time."""
