# SPDX-License-Identifier: Apache-2.0
"""A training session: episodes, transitions and pauses, driven by samples and ticks; knows no ROS.

    WAITING ──armed, learner ready──> TRAINING ──last episode──> FINISHED
                                       │    ^
             plant lost, disarmed,     v    │  armed again: the interrupted episode begins anew
             tripped                  PAUSED

An episode's end is a truncation: the value of what follows is bootstrapped. Only a trip by the box is a termination.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any, Protocol

import numpy as np

from hydro_bridge.signals import Flag, FloatArray
from hydro_policy.episode import EpisodeRecord, Phase, Progress
from hydro_policy.outputs import Outputs
from hydro_policy.policy import Policy
from hydro_policy.replay import ReplayBuffer
from hydro_policy.run import TrainingSettings
from hydro_policy.steps import Step, StepClock
from hydro_policy.task import ACTIONS, observe
from hydro_policy.watch import PlantWatch


class ActingLearner(Protocol):
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
    state
        `state()` of the session to continue, or None.
    """

    def __init__(
        self,
        settings: TrainingSettings,
        learner: ActingLearner,
        outputs: Outputs,
        *,
        rearm: bool = True,
        state: dict[str, Any] | None = None,
    ) -> None:
        self.settings, self.learner = settings, learner
        self.watch = PlantWatch(outputs, rearm)
        self.clock = StepClock()
        self.phase = Phase.WAITING
        self.progress = Progress()
        self.current = EpisodeRecord(episode=0)
        self.policy = Policy(settings.sac.hidden_size, (settings.sac.log_std_min, settings.sac.log_std_max))
        self._outputs = outputs
        self._rng = np.random.default_rng(settings.seed)
        self._observation: FloatArray | None = None
        self._action: FloatArray = np.zeros(ACTIONS)
        if state is not None:
            self.progress = Progress(**state["progress"])
            self._rng.bit_generator.state = state["random_state"]
        self._steps = self.progress.total_steps

    @property
    def finished(self) -> bool:
        """Whether all episodes are done."""
        return self.phase is Phase.FINISHED

    def state(self) -> dict[str, Any]:
        """For a checkpoint, as JSON types."""
        progress = self.progress
        summary = {"episode": progress.episode, "total_steps": progress.total_steps, "last_rmse": progress.last_rmse}
        return {**summary, "progress": asdict(progress), "random_state": self._rng.bit_generator.state}

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample [14]; True if it made a step."""
        self.watch.on_sample(flags, now)
        step = self.clock.add(sequence, sample, flags)
        if self.phase is Phase.TRAINING:
            if not flags & Flag.ARMED:
                self._interrupt(sample, flags)
            elif step is not None:
                self._step(step)
                return True
        elif not self.finished and flags & Flag.ARMED and step is not None and self.learner.ready:
            self._begin_episode()
            self._step(step)
            return True
        return False

    def on_tick(self, now: float) -> None:
        """Some twenty times a second: arming, loss of the plant, death of the learner."""
        self.watch.on_tick(now)
        if self.watch.lost and self.phase is Phase.TRAINING:
            self._pause("no samples")
        message = self.learner.revive()
        if message is not None:
            self._outputs.say(message, warning=True)

    def refresh_policy(self) -> None:
        """Take over the learner's weights if there are newer ones."""
        parameters = self.learner.new_weights()
        if parameters is not None:
            self.policy.load_flat(parameters)

    def _begin_episode(self) -> None:
        signal = self.settings.task.reference(self.progress.episode, self.settings.seed)
        self._outputs.reference(signal)
        self.current = EpisodeRecord(
            episode=self.progress.episode + 1, amplitude=signal.amplitude, frequency=signal.frequency
        )
        self.phase = Phase.TRAINING

    def _step(self, step: Step) -> None:
        """Act first, then remember: gains leave as soon as they are known."""
        self.refresh_policy()
        before, taken = self._observation, self._action
        observation = observe(step.sample, taken)
        if np.isfinite(observation).all():
            self._action = self.policy.act(observation, self._rng)
            self._outputs.gains(*self.settings.task.gains.gains(self._action), self._steps)
            self._steps += 1
            self._observation = observation
        else:
            self._observation = None  # the box trips on this; its flags come next
        if before is not None and self._observation is not None:
            reward = self.settings.task.reward(step.error, step.error_rate)
            self.current.add(step, reward)
            self.progress.total_steps += 1
            if step.whole:
                self._remember(before, taken, reward, observation, terminated=False)
        if self.current.steps >= self.settings.task.steps_per_episode:
            self._finish_episode()

    def _remember(
        self, before: FloatArray, action: FloatArray, reward: float, after: FloatArray, terminated: bool
    ) -> None:
        row = np.concatenate((before, after, action, (reward, float(terminated)))).astype(np.float32)
        self.learner.replay.extend(row[np.newaxis])

    def _finish_episode(self) -> None:
        done, progress = self.current, self.progress
        progress.episode += 1
        progress.last_return, progress.last_rmse = done.episode_return, done.force_rmse
        best = done.lag < progress.best_lag
        progress.best_lag = min(done.lag, progress.best_lag)
        progress.history.append(
            {
                "episode": progress.episode,
                "amplitude": done.amplitude,
                "frequency": done.frequency,
                "return": done.episode_return,
                "force_rmse": done.force_rmse,
                "lag": done.lag,
                "whole_steps": done.whole_steps,
                "entropy_coefficient": self.learner.entropy_coefficient,
                "updates": self.learner.updates,
            }
        )
        self.learner.save(self.state(), best)
        if progress.episode >= self.settings.episodes:
            self.phase = Phase.FINISHED
        else:
            self._begin_episode()

    def _interrupt(self, sample: FloatArray, flags: int) -> None:
        """The box disarmed under us. If it was the policy's doing, the policy shall learn it."""
        if flags & (Flag.FORCE_LIMIT | Flag.SENSOR_FAULT) and self._observation is not None:
            after = observe(sample, self._action)
            after = after if np.isfinite(after).all() else self._observation  # terminal: its value is not used
            self._remember(self._observation, self._action, -self.settings.task.trip_penalty, after, terminated=True)
        self._pause(self.watch.condition)

    def _pause(self, reason: str) -> None:
        self.phase = Phase.PAUSED
        self.progress.interruptions += 1
        self._observation = None
        self._outputs.say(
            f"paused in episode {self.current.episode} at step {self.current.steps}: {reason}", warning=True
        )
