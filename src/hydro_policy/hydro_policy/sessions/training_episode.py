# SPDX-License-Identifier: Apache-2.0
"""Training episodes: reference, exploration under the safety monitor, rewards."""

from __future__ import annotations

from hydro_policy.runs.run import TrainingSettings
from hydro_policy.sessions.episode import EpisodeRecord, Progress
from hydro_policy.sessions.exploration import Explorer
from hydro_policy.supervision.learner_requests import ActingLearner
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.outputs import Outputs
from hydro_policy.task.step_aggregator import Step


class EpisodePlayer:
    """Runs single episodes, chosen and scheduled by the session.

    Parameters
    ----------
    settings
        Settings of the run.
    learner
        Running learner; its weights are taken over before each step.
    outputs
        The graph.
    progress
        Progress of the run, which counts the steps.
    """

    def __init__(
        self, settings: TrainingSettings, learner: ActingLearner, outputs: Outputs, progress: Progress
    ) -> None:
        self.explorer = Explorer(settings, learner.replay, outputs)
        self.explorer.published = progress.total_steps
        self.monitor = SafetyMonitor(settings.monitor)
        self.current = EpisodeRecord(episode=0)
        self._settings, self._learner, self._outputs, self._progress = settings, learner, outputs, progress

    @property
    def complete(self) -> bool:
        """Whether the present episode has all its steps."""
        return self.current.steps >= self._settings.task.steps_per_episode

    def begin(self) -> None:
        """Begin the episode after the finished ones, or restart it."""
        done = self._progress.episode
        signal = self._settings.task.reference(done, self._settings.seed)
        self._outputs.reference(signal)
        self.current = EpisodeRecord(episode=done + 1, amplitude=signal.amplitude, frequency=signal.frequency)
        self.monitor.reset()

    def step(self, step: Step) -> str | None:
        """Make one step under the newest policy; if the monitor requests a stop, return why and make none."""
        reason = self.monitor.add(step)
        if reason is None:
            self.refresh_policy()
            self._count(step, self.explorer.step(step))
        return reason

    def hold(self, gains: tuple[float, float], step: Step, *, episode: bool) -> None:
        """Make one step under a person's gain changes; `episode`: it counts as a step of the present episode."""
        reward = self.explorer.hold(gains, step)
        if episode:
            self._count(step, reward)
            self.current.overridden_steps += 1
        self.monitor.reset()  # it assesses policies

    def refresh_policy(self) -> None:
        """Adopt the learner's weights if there are newer ones."""
        parameters = self._learner.new_weights()
        if parameters is not None:
            self.explorer.policy.load_flat(parameters)

    def _count(self, step: Step, reward: float | None) -> None:
        if reward is not None:
            self.current.add(step, reward)
            self._progress.total_steps += 1
