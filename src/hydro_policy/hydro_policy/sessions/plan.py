# SPDX-License-Identifier: Apache-2.0
"""The plan of a training: which trial is next, and what follows from it for learner and policy.

    examination ──> episodes ──> examination ──> episodes ──> ... ──> examination
                       ^   stopped: back to the last good policy, after too many in a row the end
                       └── interrupted: begun again

An examination is a comparison of the policy's mean action, and of fixed gains where their scores are not yet known;
learning goes on meanwhile, the acting policy does not change. `evaluation.runner.TrialRunner` makes the trials.

A plant that goes by its own clock waits for the learner: each step acts on the weights after all updates that were due
at its beginning, and examinations and checkpoints are of that state.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from hydro_core.signals import SAMPLE_PERIOD, SAMPLES_PER_STEP
from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.exploration import Explorer
from hydro_policy.evaluation.runner import TrialRunner
from hydro_policy.evaluation.trial import Comparison, Plan, Trial
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sessions.run_state import EXAMINED, LEAD, Progress, RunState
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.plant_supervisor import Outputs, PlantSupervisor
from hydro_policy.task.cases import Case, Score
from hydro_policy.task.mdp import events


class TrainingPlan(Plan):
    """Episodes and examinations, with the learner that they are for.

    Parameters
    ----------
    settings
        Settings of the run.
    learner
        Running learner.
    outputs
        The graph.
    state, best
        `state()` and best agent of the run to continue, or None.
    record
        Record of events.
    """

    training = True

    def __init__(
        self,
        settings: TrainingSettings,
        learner: LearnerSupervisor,
        outputs: Outputs,
        *,
        state: dict[str, Any] | None = None,
        best: bytes | None = None,
        record: RunRecord | None = None,
    ) -> None:
        self.settings, self.learner = settings, learner
        self.progress = Progress() if state is None else Progress(**state["progress"])
        self.run = RunState(settings, learner, self.progress, best, record)
        self.explorer = Explorer(settings, learner.replay, outputs, learner.new_weights, learner.wake)
        self.explorer.published = self.explorer.total_steps = self.progress.total_steps
        self.policy = self.explorer.policy
        if state is not None:
            self.explorer.rng.bit_generator.state = state["random_state"]
        self.exam: Comparison | None = None
        """The present examination."""
        self.scores: list[Score] = []
        """Of the present examination."""
        self._fresh = True  # no episode has passed since the box was armed
        self._trial = self._due()

    @property
    def trial(self) -> Trial | None:
        """See `Plan`."""
        return None if self.run.gave_up else self._trial

    def state(self) -> dict[str, Any]:
        """Return the state for a checkpoint, as JSON types."""
        progress = self.progress
        progress.total_steps = self.explorer.total_steps
        summary = {"episode": progress.episode, "total_steps": progress.total_steps, "last_rmse": progress.last_rmse}
        return {**summary, "progress": asdict(progress), "random_state": self.explorer.rng.bit_generator.state}

    def begin(self, trial: Trial) -> None:
        """See `Plan`: the first agent is good until a better one is known; the learner's present state is examined."""
        self.run.start()
        if self.exam is None:
            self.explorer.begin(self.progress.episode + 1, trial.case.signal)
        elif not self.scores:
            if (parameters := self.run.propose()) is not None:
                self.policy.load_flat(parameters)
            self.explorer.forget()

    def add(self, score: Score) -> str:
        """See `Plan`."""
        if score.stopped and score.controller in (EXAMINED, self.explorer.name):
            return self._stop(score.stopped)
        if self.exam is None:
            self._fresh = False
            best = self.run.add_episode(self.explorer.current)
        else:
            self.scores.append(score)
            self.exam.add(score)
            if self.exam.trial is not None:
                self._trial = self.exam.trial
                return ""
            best = self.run.add_exam(self.scores, self.policy.digest())
        self.learner.save(self.state(), best, exact=self.run.exact)
        self._trial = self._due()
        return ""

    def pause(self) -> None:
        """See `Plan`: an examination begins anew."""
        self.progress.interruptions += 1
        self._fresh = True
        self._trial = self._due()

    def wait(self, *, exact: bool) -> None:
        """See `Plan`."""
        self.run.exact = exact
        if exact:
            self.learner.settle()

    def look_after(self) -> str:
        """See `Plan`."""
        return self.learner.restart_if_dead() or ""

    def _due(self) -> Trial | None:
        """Return the first trial of what is due: an examination, the episode after the finished ones, or nothing."""
        self.exam, self.scores = None, []
        task, done = self.settings.task, self.progress.episode
        if self.run.exam_due:
            settings, base = self.settings.exam, self.settings.base_gains
            controllers: list[Controller] = [PolicyController(self.policy, task.gains, EXAMINED)]
            if reference_too := not self.progress.reference_rmse:
                controllers.append(FixedGains(settings.reference_kp, settings.reference_ki, base))
            lead = LEAD if self._fresh or reference_too else 0.0
            self.exam = Comparison(settings.evaluation, controllers, lead)
            return self.exam.trial
        if self.run.trained:
            return None
        case = Case(f"episode {done + 1}", events.reference(task, done, self.settings.seed))
        seconds = task.steps_per_episode * SAMPLES_PER_STEP * SAMPLE_PERIOD
        return Trial(controller=self.explorer, case=case, settle=0.0, measure=seconds, judged=False)

    def _stop(self, reason: str) -> str:
        """Return to the last good policy, which learns the penalty if it explored; returns what to tell the user."""
        where = f"episode {self.explorer.current.episode}"
        if self.exam is not None:
            where, self.progress.examined = "the examination", self.progress.episode
        if (good := self.run.roll_back()) is not None:
            self.policy.load_flat(good)
        sentence = self.run.add_stop(reason, where, "" if good is None else self.policy.digest())
        self._trial = self._due()
        return sentence


def training(plan: TrainingPlan, watch: PlantSupervisor) -> TrialRunner[TrainingPlan]:
    """Return the runner of a training, whose monitor stops policies."""
    return TrialRunner(plan, watch, monitor=SafetyMonitor(plan.settings.monitor))
