# SPDX-License-Identifier: Apache-2.0
"""State of a training run: progress, record of events, verdicts, and which agents are candidate, good and best.

A failing policy is replaced by the last one that passed an examination::

    learner's state ──propose──> candidate ──accept──> last good ──(best score)──> best, on disk
                                     └────── stopped: roll_back to the last good one; after too many in a row: the end
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from statistics import NormalDist
from typing import Any

import numpy as np

from hydro_core.signals import FloatArray
from hydro_policy.evaluation.exploration import EpisodeRecord
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sac.sac import actor_parameters
from hydro_policy.task.cases import ExamSettings, Score

CHANCE = 0.025
"""Probability that a score passes for better by chance, over the comparisons of the run so far (Bonferroni)."""

LEAD = 16.0
"""s that a policy, or the fixed gains, act before the first sine of an examination that follows no episode.

What arming or other gains leave in the box's integral fades with K_p / K_i, which is 6 s for (90, 15) and up to 18 s.
"""

EXAMINED = "policy"
"""Name of the policy in an examination's scores."""


@dataclass
class Progress:
    """Progress of a run; part of the checkpoint."""

    episode: int = 0
    """Episodes finished."""
    total_steps: int = 0
    interruptions: int = 0
    last_return: float = math.nan
    last_rmse: float = math.nan
    best_lag: float = math.inf
    rollbacks: int = 0
    examined: int = -1
    """Finished episodes at the last examination; -1: none yet."""
    reference_rmse: list[float] = field(default_factory=list)
    """RMSE [N] of the fixed gains that scores are relative to, one per sine; empty until they are examined."""
    best_score: float = math.inf
    """Score of the best policy so far: mean over the sines of its RMSE over the reference's."""
    passed_at: int = -1
    """Finished episodes when a policy first beat the reference at every sine; -1: not yet."""
    exams: list[dict[str, Any]] = field(default_factory=list)
    history: list[dict[str, float]] = field(default_factory=list)


class RunState:
    """The one state of a run: what has happened, what it follows for the run, and the agents that came of it.

    Parameters
    ----------
    settings
        Settings of the run.
    learner
        Running learner, which stores accepted policies.
    progress
        Progress of the run so far, as held by a checkpoint.
    best
        The best agent of the resumed run, or None.
    record
        Record of events.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        learner: LearnerSupervisor,
        progress: Progress | None = None,
        best: bytes | None = None,
        record: RunRecord | None = None,
    ) -> None:
        self.settings, self.learner = settings, learner
        self.progress, self.record = progress or Progress(), record or RunRecord()
        self.gave_up = ""
        """Why the run ended before its last episode; empty if it did not."""
        self.last_stop = ""
        """Why a policy was last stopped; empty if none was."""
        self.rollbacks_in_a_row = 0
        """Rollbacks since a policy was last accepted."""
        self.exact = False
        """Whether the plant waits for the learner, so that a run is a function of its seed."""
        self._candidate: bytes | None = None
        self._good, self._best = best, best
        if best is not None:
            learner.save_policy(best)

    @property
    def trained(self) -> bool:
        """Whether all episodes are done."""
        return self.progress.episode >= self.settings.episodes

    @property
    def improved(self) -> bool:
        """Whether a policy trained here scored better than the initial one, by more than noise."""
        return any(exam["best"] and exam["episode"] > 0 for exam in self.progress.exams)

    @property
    def exam_due(self) -> bool:
        """Whether an examination is due: before the first episode, at intervals, and after the last; once each."""
        done, every = self.progress.episode, self.settings.exam.every
        return bool(every) and self.progress.examined < done and (self.trained or done % every == 0)

    def add_episode(self, done: EpisodeRecord) -> bool:
        """Add a completed episode; returns True if its policy is the best so far."""
        progress = self.progress
        progress.episode += 1
        progress.last_return, progress.last_rmse = done.episode_return, done.force_rmse
        learnt = {"entropy_coefficient": self.learner.entropy_coefficient, "updates": self.learner.updates}
        losses = {f"{name}_loss": loss for name, loss in self.learner.losses._asdict().items()}
        progress.history.append({**done.summary(), **learnt, **losses})
        self.record.add("episode", "", **progress.history[-1])
        best = False
        if not self.settings.exam.every:  # all that is known is that it completed the episode
            best = done.lag < progress.best_lag
            self.propose()
            self.accept(best)
        progress.best_lag = min(done.lag, progress.best_lag)
        return best

    def add_exam(self, scores: Sequence[Score], digest: str = "") -> bool:
        """Add an examination completed by the policy of this digest; returns True if it is significantly the best.

        One in which the machine was held up makes no policy the best.
        The first one is that of the initial policy: the run returns it, or one that is better by more than noise.
        """
        progress, settings = self.progress, self.settings.exam
        reference = progress.reference_rmse or reference_rmse(settings, scores)
        if not any(run.spoilt for run in scores if run.controller != EXAMINED):
            progress.reference_rmse = reference
        rmse, score, error = verdict(scores, reference)
        beaten = sum(own < fixed for own, fixed in zip(rmse, reference, strict=True))
        errors = [*(exam["error"] for exam in progress.exams if not exam.get("spoilt")), error]
        kept = next((exam["error"] for exam in reversed(progress.exams) if exam["best"]), 0.0)
        spoilt = any(run.spoilt for run in scores)
        best = not spoilt and significantly_better(score, progress.best_score, errors, kept)
        self.accept(best)
        progress.examined, progress.best_score = progress.episode, score if best else progress.best_score
        if progress.passed_at < 0 and beaten == len(rmse) and not spoilt:
            progress.passed_at = progress.episode
        result = {"episode": progress.episode, "policy": digest, "rmse": rmse, "beaten": beaten}
        progress.exams.append({**result, "score": score, "error": error, "best": best, "spoilt": spoilt})
        self.record.add("exam", **progress.exams[-1], reference_rmse=reference)
        return best

    def add_stop(self, reason: str, where: str, good: str = "") -> str:
        """Add a stop with rollback of the policy; returns the sentence for the user. Too many stops: `gave_up`.

        `good` is the digest of the policy that acts from now on; empty: there is no other.
        """
        self.progress.rollbacks += 1
        self.last_stop = reason
        sentence = f"policy stopped in {where}: {reason}; rolled back to the last good one"
        sentence += f" ({good})" if good else ""
        if self.rollbacks_in_a_row > self.settings.monitor.rollbacks_max:
            self.gave_up = f"{self.rollbacks_in_a_row} rollbacks in a row, the last: {reason}"
            sentence += f"; that was once too often ({self.settings.monitor.rollbacks_max} in a row): the run ends"
        self.record.add("stop", sentence, reason=reason, rollbacks=self.progress.rollbacks)
        return sentence

    def start(self) -> None:
        """Accept the initial agent as good until a better one is known; call when the learner is ready."""
        if self._good is None:
            self.propose()
            self.accept()

    def propose(self) -> FloatArray | None:
        """Take the learner's state as candidate; returns its actor's parameters, None if there is no state yet."""
        self._candidate = self.learner.snapshot(exact=self.exact)
        return None if self._candidate is None else actor_parameters(self._candidate)

    def accept(self, best: bool = False) -> None:
        """Accept the candidate; `best`: it is better than any before."""
        if self._candidate is not None:
            self._good = self._candidate
            self._best = self._good if best else self._best
            self.learner.save_policy(self._good)
            self.rollbacks_in_a_row = 0

    @property
    def good(self) -> FloatArray | None:
        """Parameters of the last good actor; None before there is one."""
        return None if self._good is None else actor_parameters(self._good)

    @property
    def best(self) -> FloatArray | None:
        """Parameters of the best actor so far; before there is one, of the last good one."""
        return self.good if self._best is None else actor_parameters(self._best)

    def roll_back(self) -> FloatArray | None:
        """Roll back; returns the parameters of the actor that acts from now on, None if there never was a state."""
        self.rollbacks_in_a_row += 1
        if self._good is not None:
            self.learner.roll_back()
        return self.good


def significantly_better(score: float, best: float, errors: Sequence[float], best_error: float = 0.0) -> bool:
    """Return whether a score is below the best one by more than the noise of both.

    `errors`: standard errors of all scores of the run, this one's last. Two runs of a sine alone give a poor estimate
    of their scatter: the root of the mean square of all of them counts where a score's own is smaller. For a score of
    single runs it is 0: unknown. `best_error`: that of the best score.
    """
    known = [error for error in errors if error > 0.0]
    pooled = math.hypot(*known) / math.sqrt(len(known)) if known else 0.0
    noise = math.hypot(max(errors[-1], pooled), max(best_error, pooled))
    return score < best - NormalDist().inv_cdf(1.0 - CHANCE / max(len(errors) - 1, 1)) * noise


def reference_rmse(settings: ExamSettings, scores: Sequence[Score]) -> list[float]:
    """Return the force RMSE [N] of the fixed gains; runs that had to be stopped count as no tracking at all."""
    nothing = settings.evaluation.amplitude / math.sqrt(2.0)
    return [
        float(np.mean([nothing if score.stopped else score.rmse for score in runs]))
        for runs in _by_case([score for score in scores if score.controller != EXAMINED])
    ]


def verdict(scores: Sequence[Score], reference: Sequence[float]) -> tuple[list[float], float, float]:
    """Return the policy's force RMSE at each sine [N], mean over the repeats; its score; the score's standard error.

    The score is the mean of its ratios to `reference`, the RMSE of the fixed gains [N]: below 1 the policy beats them
    on average. Its error is by the scatter of repeats, 0 without; that of the reference is common to a run.
    """
    runs = [[score.rmse for score in one] for one in _by_case([s for s in scores if s.controller == EXAMINED])]
    rmse = [float(np.mean(one)) for one in runs]
    ratios = [own / other for own, other in zip(rmse, reference, strict=True)]
    repeated = [(one, other) for one, other in zip(runs, reference, strict=True) if len(one) > 1]
    errors = [float(np.std(one, ddof=1)) / math.sqrt(len(one)) / other for one, other in repeated]
    return rmse, math.fsum(ratios) / len(ratios), math.hypot(*errors) / len(ratios)


def _by_case(scores: Sequence[Score]) -> list[list[Score]]:
    """Return the runs of each sine, sines in order of first occurrence."""
    names = dict.fromkeys(score.case for score in scores)
    return [[score for score in scores if score.case == name] for name in names]
