# SPDX-License-Identifier: Apache-2.0
"""State of a training run: progress, record on disk, and the last good policy."""

from __future__ import annotations

from collections.abc import Sequence

from hydro_policy.evaluation import policy_examination
from hydro_policy.runs.record import RunRecord
from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sessions.episode import EpisodeRecord, Progress
from hydro_policy.supervision.learner_requests import ActingLearner
from hydro_policy.supervision.rollback import PolicyKeeper
from hydro_policy.task.scoring import Score


class RunState:
    """Records episodes, examinations and stops, and decides their consequences for the run.

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
        learner: ActingLearner,
        progress: Progress,
        best: bytes | None,
        record: RunRecord,
    ) -> None:
        self.progress, self.record = progress, record
        self.keeper = PolicyKeeper(learner, settings.monitor.rollbacks_max, best)
        self.gave_up = ""
        """Why the run ended before its last episode; empty if it did not."""
        self.last_stop = ""
        """Why a policy was last stopped; empty if none was."""
        self._settings, self._learner = settings, learner

    @property
    def trained(self) -> bool:
        """Whether all episodes are done."""
        return self.progress.episode >= self._settings.episodes

    @property
    def exam_due(self) -> bool:
        """Whether an examination is due: before the first episode, at intervals, and after the last; once each."""
        done, every = self.progress.episode, self._settings.exam.every
        return bool(every) and self.progress.examined < done and (self.trained or done % every == 0)

    def add_episode(self, done: EpisodeRecord) -> bool:
        """Add a completed episode; returns True if its policy is the best so far."""
        progress = self.progress
        progress.episode += 1
        progress.last_return, progress.last_rmse = done.episode_return, done.force_rmse
        learnt = {"entropy_coefficient": self._learner.entropy_coefficient, "updates": self._learner.updates}
        progress.history.append({**done.summary(), **learnt})
        self.record.add("episode", "", **progress.history[-1])
        best = False
        if not self._settings.exam.every:  # all that is known is that it completed the episode
            best = done.lag < progress.best_lag
            self.keeper.propose()
            self.keeper.accept(best)
        progress.best_lag = min(done.lag, progress.best_lag)
        return best

    def add_exam(self, scores: Sequence[Score], digest: str = "") -> bool:
        """Add an examination completed by the policy of this digest; returns True if it is significantly the best.

        The first one is that of the initial policy: the run returns it, or one that is better by more than noise.
        """
        progress, settings = self.progress, self._settings.exam
        progress.reference_rmse = progress.reference_rmse or policy_examination.reference_rmse(settings, scores)
        verdict = policy_examination.verdict(scores, progress.reference_rmse)
        errors = [*(exam.get("error", 0.0) for exam in progress.exams), verdict.score_error]
        kept = next((exam.get("error", 0.0) for exam in reversed(progress.exams) if exam["best"]), 0.0)
        best = policy_examination.significantly_better(verdict.score, progress.best_score, errors, kept)
        self.keeper.accept(best)
        progress.examined, progress.best_score = progress.episode, verdict.score if best else progress.best_score
        if progress.passed_at < 0 and verdict.beaten == len(verdict.rmse):
            progress.passed_at = progress.episode
        result = {"episode": progress.episode, "policy": digest, "rmse": list(verdict.rmse), "beaten": verdict.beaten}
        progress.exams.append({**result, "score": verdict.score, "error": verdict.score_error, "best": best})
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
        if self.keeper.exhausted:
            self.gave_up = f"{self.keeper.in_a_row} rollbacks in a row, the last: {reason}"
            sentence += f"; that was once too often ({self._settings.monitor.rollbacks_max} in a row): the run ends"
        self.record.add("stop", sentence, reason=reason, rollbacks=self.progress.rollbacks)
        return sentence
