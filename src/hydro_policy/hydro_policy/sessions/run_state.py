# SPDX-License-Identifier: Apache-2.0
"""State of a training run: progress, record of events, and which agents are candidate, good and best.

A failing policy is replaced by the last one that passed an examination::

    learner's state ──propose──> candidate ──accept──> last good ──(best score)──> best, on disk
                                     └────── stopped: roll_back to the last good one; after too many in a row: the end
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from hydro_bridge.signals import FloatArray
from hydro_policy.evaluation import policy_examination
from hydro_policy.learner_process.supervisor import LearnerSupervisor
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sac.snapshot import actor_parameters
from hydro_policy.sessions.episode import EpisodeRecord
from hydro_policy.task.cases import Score


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
        self._candidate: bytes | None = None
        self._good, self._best = best, best
        if best is not None:
            learner.save_policy(best)

    @property
    def trained(self) -> bool:
        """Whether all episodes are done."""
        return self.progress.episode >= self.settings.episodes

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

        The first one is that of the initial policy: the run returns it, or one that is better by more than noise.
        """
        progress, settings = self.progress, self.settings.exam
        progress.reference_rmse = progress.reference_rmse or policy_examination.reference_rmse(settings, scores)
        verdict = policy_examination.verdict(scores, progress.reference_rmse)
        errors = [*(exam.get("error", 0.0) for exam in progress.exams), verdict.error]
        kept = next((exam.get("error", 0.0) for exam in reversed(progress.exams) if exam["best"]), 0.0)
        best = policy_examination.significantly_better(verdict.score, progress.best_score, errors, kept)
        self.accept(best)
        progress.examined, progress.best_score = progress.episode, verdict.score if best else progress.best_score
        if progress.passed_at < 0 and verdict.beaten == len(verdict.rmse):
            progress.passed_at = progress.episode
        result = {"episode": progress.episode, "policy": digest, "rmse": verdict.rmse, "beaten": verdict.beaten}
        progress.exams.append({**result, "score": verdict.score, "error": verdict.error, "best": best})
        self.record.add("exam", **progress.exams[-1], reference_rmse=progress.reference_rmse)
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
        self._candidate = self.learner.snapshot()
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
