# SPDX-License-Identifier: Apache-2.0
"""A training session: episodes, examinations, stops and pauses, driven by samples and ticks; knows no ROS.

    WAITING ──armed, learner ready──> EVALUATING ──good──> TRAINING ──────episodes─────> EVALUATING ──last──> FINISHED
                                                              │  ^
             plant lost, disarmed, tripped; stopped by the    v  │  armed again, calm again: what was interrupted
             monitor: back to the last good policy          PAUSED  begins anew

An episode's end is a truncation: the value of what follows is bootstrapped. Only a trip by the box or a stop by the
monitor is a termination.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Protocol

from hydro_bridge.signals import Flag, FloatArray, ReferenceSignal
from hydro_policy import exam
from hydro_policy.acting import Explorer
from hydro_policy.episode import EpisodeRecord, Phase, Progress
from hydro_policy.evaluation import EvaluationSession
from hydro_policy.monitor import SafetyMonitor
from hydro_policy.outputs import Outputs
from hydro_policy.override import GainOverride
from hydro_policy.policy import Policy
from hydro_policy.record import RunRecord
from hydro_policy.replay import ReplayBuffer
from hydro_policy.rollback import PolicyKeeper, RollingLearner
from hydro_policy.run import TrainingSettings
from hydro_policy.steps import Step, StepClock
from hydro_policy.watch import PlantWatch

CALM = 1.0
"""s of base gains and no reference after a stop, before anything begins anew."""
FAULTS = Flag.FORCE_LIMIT | Flag.SENSOR_FAULT


class ActingLearner(RollingLearner, Protocol):
    """What acting needs of learning: `LearnerSupervisor`, or `InlineLearner` in simulation."""

    replay: ReplayBuffer

    @property
    def ready(self) -> bool:
        """Whether weights have been published."""

    @property
    def updates(self) -> int:
        """Gradient updates so far."""

    @property
    def entropy_coefficient(self) -> float:
        """alpha."""

    def new_weights(self) -> FloatArray | None:
        """The actor's flat parameters if there are newer ones."""

    def revive(self) -> str | None:
        """Restart it if it died; returns what to tell the user."""

    def save(self, trainer: dict[str, Any], best: bool = False) -> bool:
        """Ask for a checkpoint."""


class TrainingSession:
    """Turns samples into actions and transitions, episode after episode.

    Parameters
    ----------
    settings
        Of the run.
    learner
        Running learner; its weights are taken over before each step.
    outputs
        The graph.
    rearm
        See `PlantWatch`.
    state, best
        `state()` and best agent of the session to continue, or None.
    override
        Gains that a person holds.
    record
        Takes down what happens.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        learner: ActingLearner,
        outputs: Outputs,
        *,
        rearm: bool = True,
        state: dict[str, Any] | None = None,
        best: bytes | None = None,
        override: GainOverride | None = None,
        record: RunRecord | None = None,
    ) -> None:
        self.settings, self.learner = settings, learner
        self.watch = PlantWatch(outputs, rearm)
        self.override, self.record = override or GainOverride(), record or RunRecord()
        self.clock, self.monitor = StepClock(), SafetyMonitor(settings.monitor)
        self.explorer = Explorer(settings, learner.replay, outputs)
        self.keeper = PolicyKeeper(learner, settings.monitor.rollbacks_max, best)
        self.phase = Phase.WAITING
        self.progress = Progress()
        self.current = EpisodeRecord(episode=0)
        self.exam: EvaluationSession | None = None
        self.gave_up = ""
        """Why the run ended before its last episode; empty if it did not."""
        self.last_stop = ""
        """Why a policy was last stopped; empty if none was."""
        self._outputs = outputs
        self._calm_until = 0.0
        if state is not None:
            self.progress = Progress(**state["progress"])
            self.explorer.rng.bit_generator.state = state["random_state"]
        self.explorer.published = self.progress.total_steps

    @property
    def policy(self) -> Policy:
        """As it acts."""
        return self.explorer.policy

    @property
    def finished(self) -> bool:
        """Whether all episodes are done, or the run was given up."""
        return self.phase is Phase.FINISHED

    def state(self) -> dict[str, Any]:
        """For a checkpoint, as JSON types."""
        progress = self.progress
        summary = {"episode": progress.episode, "total_steps": progress.total_steps, "last_rmse": progress.last_rmse}
        return {**summary, "progress": asdict(progress), "random_state": self.explorer.rng.bit_generator.state}

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample [14]; True if gains went out."""
        self.watch.on_sample(flags, now)
        step = self.clock.add(sequence, sample, flags)
        if self.finished:
            return False
        if not flags & Flag.ARMED:
            if self.phase in (Phase.TRAINING, Phase.EVALUATING):
                self._interrupt(sample, flags, now)
            return False
        if self.exam is not None:
            return self._examine(self.exam, sequence, sample, flags, now)
        return step is not None and self._act(step, now)

    def on_correction(self, after: float, status: int) -> None:
        """Take what the filter says of a sample: M_c [1/s] under its correction, and the status."""
        self.monitor.on_correction(after, status)

    def on_tick(self, now: float) -> None:
        """Some twenty times a second: arming, loss of the plant, death of the learner."""
        self.watch.on_tick(now)
        if self.watch.lost and self.phase in (Phase.TRAINING, Phase.EVALUATING):
            self._pause("no samples")
        message = self.learner.revive()
        if message is not None:
            self._outputs.say(message, warning=True)

    def refresh_policy(self) -> None:
        """Take over the learner's weights if there are newer ones."""
        parameters = self.learner.new_weights()
        if parameters is not None:
            self.policy.load_flat(parameters)

    def _act(self, step: Step, now: float) -> bool:
        """One policy step of an armed plant outside of examinations; True if gains went out."""
        held = self.override.gains(now)
        if held is not None:
            self._count(step, self.explorer.hold(held, step))
            self.current.overridden_steps += self.phase is Phase.TRAINING
            self.monitor.reset()  # it judges policies
            return True
        if now < self._calm_until:
            self.explorer.hold((0.0, 0.0))
            return True
        if self.phase is not Phase.TRAINING:
            if not self.learner.ready or not self.watch.may_begin(now):
                return False
            self._begin()
        if self.phase is Phase.TRAINING:
            self._step(step, now)
        return True

    def _begin(self) -> None:
        """Whatever is due: an examination, an episode, or the end."""
        self.keeper.start()
        done, settings = self.progress.episode, self.settings
        last = done >= settings.episodes
        if settings.exam.every and self.progress.examined < done and (last or done % settings.exam.every == 0):
            self._begin_exam()
        elif last:
            self.phase = Phase.FINISHED
        else:
            self._begin_episode()

    def _begin_episode(self) -> None:
        signal = self.settings.task.reference(self.progress.episode, self.settings.seed)
        self._outputs.reference(signal)
        self.current = EpisodeRecord(
            episode=self.progress.episode + 1, amplitude=signal.amplitude, frequency=signal.frequency
        )
        self.monitor.reset()
        self.phase = Phase.TRAINING

    def _step(self, step: Step, now: float) -> None:
        reason = self.monitor.add(step)
        if reason is None:
            self.refresh_policy()
            self._count(step, self.explorer.step(step))
        else:
            self._stop(reason, step.sample, now)
        if self.phase is Phase.TRAINING and self.current.steps >= self.settings.task.steps_per_episode:
            self._finish_episode()

    def _count(self, step: Step, reward: float | None) -> None:
        if reward is not None and self.phase is Phase.TRAINING:
            self.current.add(step, reward)
            self.progress.total_steps += 1

    def _finish_episode(self) -> None:
        done, progress = self.current, self.progress
        progress.episode += 1
        progress.last_return, progress.last_rmse = done.episode_return, done.force_rmse
        progress.history.append(
            {
                **done.summary(),
                "entropy_coefficient": self.learner.entropy_coefficient,
                "updates": self.learner.updates,
            }
        )
        self.record.add("episode", "", **progress.history[-1])
        best = False
        if not self.settings.exam.every:  # nothing better is known of it than that it came through
            best = done.lag < progress.best_lag
            self.keeper.propose()
            self.keeper.accept(best)
        progress.best_lag = min(done.lag, progress.best_lag)
        self.learner.save(self.state(), best)
        self._begin()

    def _begin_exam(self) -> None:
        """Examine the learner's present state; learning goes on meanwhile, acting does not change."""
        parameters = self.keeper.propose()
        if parameters is not None:
            self.policy.load_flat(parameters)
        around = exam.Surroundings(self._outputs, self.watch, self.override, self.monitor)
        reference_too = not self.progress.reference_rmse
        gains = self.settings.task.gains
        self.exam = exam.examination(self.settings.exam, self.policy, gains, reference_too, around)
        self.explorer.forget()
        self.phase = Phase.EVALUATING

    def _examine(self, running: EvaluationSession, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        acted = running.on_sample(sequence, sample, flags, now)
        reason = exam.failure(running.scores)
        if reason:
            self._stop(reason, sample, now)
        elif running.finished:
            self._finish_exam(running)
        return acted

    def _finish_exam(self, done: EvaluationSession) -> None:
        progress, self.exam = self.progress, None
        progress.reference_rmse = progress.reference_rmse or exam.reference_rmse(self.settings.exam, done.scores)
        verdict = exam.verdict(done.scores, progress.reference_rmse)
        best = verdict.score < progress.best_score
        self.keeper.accept(best)
        progress.examined, progress.best_score = progress.episode, min(verdict.score, progress.best_score)
        if progress.passed_at < 0 and verdict.beaten == len(verdict.rmse):
            progress.passed_at = progress.episode
        result = {"episode": progress.episode, "rmse": verdict.rmse, "score": verdict.score, "best": best}
        progress.exams.append({**result, "rmse": list(verdict.rmse), "beaten": verdict.beaten})
        self.record.add("exam", **progress.exams[-1], reference_rmse=progress.reference_rmse)
        self.learner.save(self.state(), best)
        self._begin()

    def _interrupt(self, sample: FloatArray, flags: int, now: float) -> None:
        """The box disarmed under us. If it was the policy's doing, the policy goes, and shall learn it."""
        if flags & FAULTS:
            self._stop(f"the box {self.watch.condition}", sample, now)
        if not self.finished:
            self._pause(self.watch.condition)

    def _stop(self, reason: str, sample: FloatArray, now: float) -> None:
        """What the policy does is not bearable: base gains, calm, the last good policy; after too many, the end."""
        where = "the examination" if self.exam is not None else f"episode {self.current.episode}"
        if self.exam is None:
            self.explorer.terminate(sample)
        else:
            self.progress.examined, self.exam = self.progress.episode, None
        self.explorer.hold((0.0, 0.0))
        self._outputs.reference(ReferenceSignal())
        self.phase, self._calm_until = Phase.PAUSED, now + CALM
        good = self.keeper.roll_back()
        if good is not None:
            self.policy.load_flat(good)
        self.progress.rollbacks += 1
        self.last_stop = reason
        sentence = f"policy stopped in {where}: {reason}; rolled back to the last good one"
        if self.keeper.exhausted:
            self.gave_up = f"{self.keeper.in_a_row} rollbacks in a row, the last: {reason}"
            sentence += f"; that was once too often ({self.settings.monitor.rollbacks_max} in a row): the run ends"
            self.phase = Phase.FINISHED
        self._outputs.say(sentence, warning=True)
        self.record.add("stop", sentence, reason=reason, rollbacks=self.progress.rollbacks)

    def _pause(self, reason: str) -> None:
        where = "the examination" if self.exam is not None else f"episode {self.current.episode}"
        self.phase, self.exam = Phase.PAUSED, None
        self.progress.interruptions += 1
        self.explorer.forget()
        sentence = f"paused in {where} at step {self.current.steps}: {reason}"
        self._outputs.say(sentence, warning=True)
