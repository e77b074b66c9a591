# SPDX-License-Identifier: Apache-2.0
"""Training plan: sequence of episodes and examinations, selection of the candidate, good and best agents.

    examination ──> episodes ──> examination ──> episodes ──> ... ──> examination
                       ^   stopped: rollback to the last good policy; after too many in a row the run ends
                       └── interrupted: restarted

    learner's state ──propose──> candidate ──accept──> last good ──(best score)──> best, on disk: kept by the learner

An examination is an evaluation of the policy's mean action on sines, at first also of fixed reference gains. Learning
continues meanwhile, with the acting policy unchanged. `evaluation.runner.TrialRunner` runs the trials.

A plant on its own clock waits for the learner: the weights of each step include all updates due at its start, and so do
those of examinations and checkpoints.
"""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from dataclasses import asdict, dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP, FloatArray
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.exploration import EpisodeRecord, Explorer
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison, Plan, Trial
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run_directory import RunRecord, TrainingSettings
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import Outputs, PlantSupervisor
from hydro_policy.task.cases import Case, ExamSettings, Score
from hydro_policy.task.mdp import events

SIGNIFICANCE_LEVEL = 0.025
"""Significance level of the one-sided tests for a better score, over the run's tests so far (Bonferroni)."""

EXTRA_SETTLING_TIME = 16.0
"""Additional settling time [s] of each controller in an examination after arming, or with the fixed gains.

The state of the box's integral after arming, or under other gains, decays with the time constant K_p / K_i: 6 s for
(90, 15), at most 18 s.
"""

POLICY_NAME = "policy"  # name of the policy in an examination's scores


@dataclass
class Progress:
    """Counters and results of a training run; part of the checkpoint."""

    episode: int = 0  # episodes finished
    total_steps: int = 0
    interruptions: int = 0
    last_return: float = math.nan
    last_rmse: float = math.nan
    best_lag: float = math.inf
    rollbacks: int = 0
    examined: int = -1  # finished episodes at the last examination; -1: none yet
    reference_rmse: list[float] = field(default_factory=list)
    """Force RMSE [N] of the fixed reference gains at each sine, for relative scores; empty before their examination."""
    best_score: float = math.inf
    """Score of the best policy so far: mean over the sines of its RMSE relative to that of the fixed gains."""
    exams: list[dict[str, Any]] = field(default_factory=list)
    history: list[dict[str, float]] = field(default_factory=list)


class TrainingPlan(Plan):
    """Plan of a training run: alternates episodes and examinations, and accepts or rolls back the learner's agents.

    `settings`: settings of the run. `learner`: running learner, which stores accepted agents. `outputs`: outputs to the
    graph. `state`, `best`: `state()` and best agent of a run to resume, or None. `record`: record of events.
    """

    training = True

    def __init__(
        self,
        settings: TrainingSettings,
        learner: LearnerSupervisor,
        outputs: Outputs,
        *,
        state: dict[str, Any] | None = None,
        best: FloatArray | None = None,
        record: RunRecord | None = None,
    ) -> None:
        self.settings, self.learner, self.record = settings, learner, record or RunRecord()
        self.progress = Progress() if state is None else Progress(**state["progress"])
        self.abort_reason = ""  # why the run ended before its last episode; empty if it did not
        self.last_stop_reason = ""  # why a policy was last stopped; empty if none was
        self.rollbacks_in_a_row = 0  # rollbacks since a policy was last accepted
        self.explorer = Explorer(settings, learner.append, outputs, learner.new_weights)
        self.explorer.published = self.explorer.total_steps = self.progress.total_steps
        if state is not None:
            self.explorer.rng.bit_generator.state = state["random_state"]
        self.policy = self.explorer.policy
        self.examination: Comparison | None = None  # the present examination
        self.scores: list[Score] = []  # of the present examination
        self._candidate: FloatArray | None = None  # flat parameters of actors
        self._good, self._best = best, best
        self._fresh = True  # no episode has passed since the box was armed
        self.set_trials(self._in_turn())

    # ---------------------------------------------------------------------------------------------------- trials

    @property
    def trial(self) -> Trial | None:
        """Present trial, as `Plan.trial`; None also for an aborted run."""
        return None if self.abort_reason else self._trial

    @property
    def trained(self) -> bool:
        """Whether all episodes are done."""
        return self.progress.episode >= self.settings.episodes

    def prepare_trial(self, trial: Trial) -> None:
        """Start a training episode or an examination, as `Plan.prepare_trial`.

        An examination's first trial loads the learner's current parameters into the policy.
        """
        self.accept_initial_agent()
        if self.examination is None:
            number, signal = self.progress.episode + 1, trial.case.signal
            self.explorer.current = EpisodeRecord(
                episode=number, amplitude=signal.amplitude, frequency=signal.frequency
            )
        elif not self.scores:
            if (parameters := self.propose()) is not None:
                self.policy.load_flat(parameters)
            self.explorer.discard_action()

    def add(self, score: Score) -> str:
        """Process a trial's score, as `Plan.add`; a stopped policy is rolled back to the last good one."""
        if score.stopped and score.controller in (POLICY_NAME, self.explorer.name):
            return self._stop(score.stopped)
        return super().add(score)

    def _in_turn(self) -> Generator[Trial, Score, None]:
        """Yield the trials: episodes, with an examination first, last, and after each `exam.every` episodes."""
        task, exam, progress, learner = self.settings.task, self.settings.exam, self.progress, self.learner
        while True:
            self.examination, self.scores, done = None, [], progress.episode
            if exam.every and progress.examined < done and (self.trained or done % exam.every == 0):
                controllers: list[Controller] = [PolicyController(self.policy, task.gains, POLICY_NAME)]
                if reference_too := not progress.reference_rmse:
                    controllers.append(FixedGains(exam.reference_kp, exam.reference_ki, self.settings.base_gains))
                self.examination = Comparison(
                    exam.evaluation, controllers, EXTRA_SETTLING_TIME if self._fresh or reference_too else 0.0
                )
                for trial in self.examination.trials:
                    self.scores.append((yield trial))
                best = self.add_examination(self.scores, self.policy.digest())
            elif self.trained:
                return
            else:
                case = Case(f"episode {done + 1}", events.reference(task, done, self.settings.seed))
                seconds = task.steps_per_episode * SAMPLES_PER_STEP * SAMPLE_PERIOD
                yield Trial(controller=self.explorer, case=case, settle=0.0, measure=seconds, is_scored=False)
                episode, self._fresh = self.explorer.current, False
                progress.episode += 1
                progress.last_return, progress.last_rmse = episode.episode_return, episode.force_rmse
                now = learner.status
                learnt = {"entropy_coefficient": now.alpha, "updates": now.updates}
                losses = {f"{name}_loss": loss for name, loss in now.losses._asdict().items()}
                progress.history.append({**episode.summary(), **learnt, **losses})
                self.record.add("episode", "", **progress.history[-1])
                best = not exam.every and episode.lag < progress.best_lag
                if not exam.every:  # all that is known is that it completed the episode
                    self.propose()
                    self._accept(best)
                progress.best_lag = min(episode.lag, progress.best_lag)
            learner.save(self.state())

    def pause(self) -> None:
        """Count an interruption, as `Plan.pause`; the examination restarts at its first trial."""
        self.progress.interruptions += 1
        self._fresh = True
        self.set_trials(self._in_turn())

    def prepare_step(self, *, synchronous: bool) -> None:
        """Wait for the learner's due updates if the plant waits, too (`synchronous`), as `Plan.prepare_step`."""
        self.learner.synchronous = synchronous
        self.learner.wait_for_updates()

    def poll(self) -> str:
        """Raise LearnerError if the learner has ended, as `Plan.poll`."""
        self.learner.check()
        return ""

    def state(self) -> dict[str, Any]:
        """Return the plan's state for a checkpoint (progress, random state of the exploration), as JSON types."""
        progress = self.progress
        progress.total_steps = self.explorer.total_steps
        notes = {"episode": progress.episode, "total_steps": progress.total_steps, "last_rmse": progress.last_rmse}
        return {"notes": notes, "progress": asdict(progress), "random_state": self.explorer.rng.bit_generator.state}

    # ---------------------------------------------------------------------------------------------------- results

    def add_examination(self, scores: Sequence[Score], digest: str = "") -> bool:
        """Record an examination of the policy with this digest; returns whether its score is significantly the best.

        A disturbed examination (lost samples, late commands) makes no policy the best. The first one is of the initial
        policy, which is the run's result unless a later policy is significantly better.
        """
        progress = self.progress
        reference = progress.reference_rmse or reference_rmse(self.settings.exam, scores)
        if not any(run.disturbed for run in scores if run.controller != POLICY_NAME):
            progress.reference_rmse = reference
        rmse, score, error = examination_score(scores, reference)
        beaten = sum(own < fixed for own, fixed in zip(rmse, reference, strict=True))
        errors = [*(exam["error"] for exam in progress.exams if not exam.get("spoilt")), error]
        best_error = next((exam["error"] for exam in reversed(progress.exams) if exam["best"]), 0.0)
        disturbed = any(run.disturbed for run in scores)
        best = not disturbed and significantly_better(score, progress.best_score, errors, best_error)
        self._accept(best)
        progress.examined, progress.best_score = progress.episode, score if best else progress.best_score
        result = {"episode": progress.episode, "policy": digest, "rmse": rmse, "beaten": beaten}
        progress.exams.append({**result, "score": score, "error": error, "best": best, "spoilt": disturbed})
        self.record.add("exam", **progress.exams[-1], reference_rmse=reference)
        return best

    def _stop(self, reason: str) -> str:
        """Roll back to the last good policy; returns the message for the user.

        Too many stops in a row end the run.
        """
        where = f"episode {self.explorer.current.episode}"
        if self.examination is not None:
            where, self.progress.examined = "the examination", self.progress.episode
        self.progress.rollbacks += 1
        self.rollbacks_in_a_row += 1
        self.last_stop_reason, most = reason, self.settings.monitor.rollbacks_max
        sentence = f"policy stopped in {where}: {reason}; rolled back to the last good one"
        if self._good is not None:
            self.learner.roll_back()
            self.policy.load_flat(self._good)
            sentence += f" ({self.policy.digest()})"
        if self.rollbacks_in_a_row > most:
            self.abort_reason = f"{self.rollbacks_in_a_row} rollbacks in a row, the last: {reason}"
            sentence += ": the run ends"
        self.record.add("stop", sentence, reason=reason, rollbacks=self.progress.rollbacks)
        self.set_trials(self._in_turn())
        return sentence

    # ----------------------------------------------------------------------------------------------------- agents

    def accept_initial_agent(self) -> None:
        """Accept the initial agent as the last good one if there is none yet; the learner must be ready."""
        if self._good is None:
            self.propose()
            self._accept()

    def propose(self) -> FloatArray | None:
        """Make the learner's state the candidate; returns its actor's parameters, or None before the first state."""
        self._candidate = self.learner.propose()
        return self._candidate

    def _accept(self, best: bool = False) -> None:
        if self._candidate is not None:
            self._good = self._candidate
            self._best = self._good if best else self._best
            self.learner.accept(best)
            self.rollbacks_in_a_row = 0

    @property
    def good(self) -> FloatArray | None:
        """Parameters of the last good actor; None before there is one."""
        return self._good

    @property
    def best(self) -> FloatArray | None:
        """Parameters of the best actor so far; before there is one, of the last good one."""
        return self._good if self._best is None else self._best

    @property
    def improved(self) -> bool:
        """Whether a policy trained in this run scored significantly better than the initial one."""
        return any(exam["best"] and exam["episode"] > 0 for exam in self.progress.exams)


def significantly_better(score: float, best: float, errors: Sequence[float], best_error: float = 0.0) -> bool:
    """Return whether a score is significantly below the best one: one-sided z-test, Bonferroni-corrected.

    `errors`: standard errors of the run's scores, this one's last; 0: unknown (single runs). Their root mean square is
    a lower bound on both errors of the test, since two repeats alone are a poor estimate of the scatter. `best_error`:
    standard error of the best score.
    """
    known = [error for error in errors if error > 0.0]
    pooled = math.hypot(*known) / math.sqrt(len(known)) if known else 0.0
    noise = math.hypot(max(errors[-1], pooled), max(best_error, pooled))
    return score < best - NormalDist().inv_cdf(1.0 - SIGNIFICANCE_LEVEL / max(len(errors) - 1, 1)) * noise


def reference_rmse(settings: ExamSettings, scores: Sequence[Score]) -> list[float]:
    """Return the fixed gains' force RMSE [N] at each sine, mean over repeats; a stopped run has the reference's RMS."""
    nothing = settings.evaluation.amplitude / math.sqrt(2.0)
    return [
        float(np.mean([nothing if score.stopped else score.rmse for score in runs]))
        for runs in _by_case([score for score in scores if score.controller != POLICY_NAME])
    ]


def examination_score(scores: Sequence[Score], reference: Sequence[float]) -> tuple[list[float], float, float]:
    """Return the policy's force RMSE at each sine [N], mean over the repeats; its score; the score's standard error.

    The score is the mean ratio of the policy's RMSE to `reference`, the RMSE of the fixed gains [N]: below 1 the policy
    is better on average. The error is from the scatter of repeats, 0 without; the reference's, common to all scores of
    a run, is excluded.
    """
    runs = [[score.rmse for score in one] for one in _by_case([s for s in scores if s.controller == POLICY_NAME])]
    rmse = [float(np.mean(one)) for one in runs]
    ratios = [own / other for own, other in zip(rmse, reference, strict=True)]
    repeated = [(one, other) for one, other in zip(runs, reference, strict=True) if len(one) > 1]
    errors = [float(np.std(one, ddof=1)) / math.sqrt(len(one)) / other for one, other in repeated]
    return rmse, math.fsum(ratios) / len(ratios), math.hypot(*errors) / len(ratios)


def _by_case(scores: Sequence[Score]) -> list[list[Score]]:
    """Return the runs of each sine, sines in order of first occurrence."""
    names = dict.fromkeys(score.case for score in scores)
    return [[score for score in scores if score.case == name] for name in names]


def training(plan: TrainingPlan, supervisor: PlantSupervisor) -> TrialRunner[TrainingPlan]:
    """Return the trial runner of a training plan, with a safety monitor."""
    return TrialRunner(plan, supervisor, monitor=SafetyMonitor(plan.settings.monitor))
