# SPDX-License-Identifier: Apache-2.0
"""Exploration: controller of a training episode at 100 Hz, and statistics of the episode."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hydro_core.process.realtime import Latency
from hydro_core.signals import FloatArray
from hydro_policy.evaluation.controllers import Controller
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.sac.policy import Policy
from hydro_policy.supervision.plant_supervisor import Outputs
from hydro_policy.task.mdp import ACTION_SIZE, REFERENCE_RATE, Step, observe, rewards

EXPLORER_NAME = "exploring policy"
SETTLING_STEPS = 50  # initial steps of an episode excluded from its RMSE: the references' cross-fade takes 0.3 s


@dataclass(kw_only=True)
class EpisodeRecord:
    """Statistics of one training episode: return, force RMSE, lag, overridden steps."""

    episode: int
    amplitude: float = 0.0
    frequency: float = 0.0
    steps: int = 0
    episode_return: float = 0.0
    whole_steps: int = 0
    square_error: float = 0.0
    square_rate: float = 0.0
    samples: int = 0
    overridden_steps: int = 0

    def add(self, step: Step, reward: float) -> None:
        """Add a policy step and its reward."""
        self.steps += 1
        self.whole_steps += step.whole
        self.episode_return += reward
        if self.steps > SETTLING_STEPS:
            self.square_error += float(np.dot(step.error, step.error))
            self.square_rate += float(step.sample[REFERENCE_RATE]) ** 2 * len(step.error)
            self.samples += len(step.error)

    @property
    def force_rmse(self) -> float:
        """Force RMSE [N] after settling; NaN before."""
        return math.sqrt(self.square_error / self.samples) if self.samples else math.nan

    @property
    def lag(self) -> float:
        """RMSE over the RMS of f_r' [s]: comparable between references, since the error is mostly a lag."""
        return math.sqrt(self.square_error / self.square_rate) if self.square_rate else math.inf

    def summary(self) -> dict[str, float]:
        """Return the episode's summary for records."""
        names = ("episode", "amplitude", "frequency", "force_rmse", "lag", "whole_steps", "overridden_steps")
        return {**{name: getattr(self, name) for name in names}, "return": self.episode_return}


class Explorer(Controller):
    """Exploring controller: draws the policy's action in each step, and appends the transitions to the replay buffer.

    An episode continues from the final state of the previous one, and through an override, which is not learnt from.
    Its end is a truncation: the next state's value is bootstrapped. Only a trip by the box or a stop by the monitor is
    a termination.

    `settings`: settings of the run. `append`: stores a transition, a row of the replay buffer. `outputs`: outputs to
    the graph. `new_weights`: returns the actor's parameters if they are newer, else None.
    """

    name = EXPLORER_NAME

    def __init__(
        self,
        settings: TrainingSettings,
        append: Callable[[NDArray[np.float32]], None],
        outputs: Outputs,
        new_weights: Callable[[], FloatArray | None],
    ) -> None:
        self.task, self.gain_range = settings.task, settings.task.gains
        self.policy = Policy(settings.sac, settings.task.size)
        self.rng = np.random.default_rng(settings.seed)
        self.inference = Latency()  # observe, act, map to gains
        self.published = 0  # number of gains sent so far, from any source: the message's step
        self.total_steps = 0  # of all episodes
        self.current = EpisodeRecord(episode=0)  # the present episode, or the last one
        self._append, self._outputs, self._new_weights = append, outputs, new_weights
        self._observation: FloatArray | None = None
        self._action: FloatArray = np.zeros(ACTION_SIZE)

    def act(self, step: Step) -> None:
        """Publish the newest policy's gains for a step, then store the transition, which would delay the gains."""
        parameters = self._new_weights()
        if parameters is not None:
            self.policy.load_flat(parameters)
        before, taken, began = self._observation, self._action, time.perf_counter()
        self._observation, observation = None, observe(step.sample, taken, self.task.size)
        if np.isfinite(observation).all():  # else the box trips on this; its flags follow
            self._action, mean = self.policy.draw(observation, self.rng)
            gains = self.task.gains.gains(self._action)
            self.inference.add(time.perf_counter() - began)
            self._outputs.publish_gains(*gains, self.published)
            self.published += 1
            self._observation = observation
            reward = math.nan if before is None else self._end_step(before, taken, step, observation)
            weights = int(self.policy.digest(), 16)
            self._outputs.publish_step(self.published - 1, self.task.gains.gains(mean), reward, weights)

    def override_gains(self, gains: tuple[float, float], step: Step | None = None, *, under_way: bool = False) -> None:
        """Publish these gain changes instead of the policy's; the transitions that follow are not stored.

        The step that ends with them was under the policy, and is stored. `under_way`: whether an episode is running.
        """
        if self._observation is not None and step is not None:
            after = observe(step.sample, self._action, self.task.size)
            self._end_step(self._observation, self._action, step, after, under_way=under_way)
        self.current.overridden_steps += under_way
        self._outputs.publish_gains(*gains, self.published)
        self.published += 1
        self._observation = None
        self._action = np.clip(self.task.gains.action(*gains), -1.0, 1.0)  # previous action in the policy's observation

    def terminate(self, sample: FloatArray) -> None:
        """Store the last action's transition as terminal, with the trip penalty, after a trip or stop."""
        if self._observation is not None:
            after = observe(sample, self._action, self.task.size)
            after = after if np.isfinite(after).all() else self._observation  # terminal: its value is not used
            transition = np.concatenate((self._observation, after, self._action, (rewards.trip(self.task), 1.0)))
            self._append(transition.astype(np.float32))
        self.discard_action()

    def discard_action(self) -> None:
        """Discard the last action, without a transition: the next sample is not its result."""
        self._observation = None

    def _end_step(
        self, before: FloatArray, action: FloatArray, step: Step, after: FloatArray, *, under_way: bool = True
    ) -> float:
        """Store the transition that ends with this step, and count it; returns its reward."""
        reward = float(rewards.tracking(self.task, step.error, step.error_rate))
        if step.whole and np.isfinite(after).all():
            transition = np.concatenate((before, after, action, (reward, 0.0)))
            self._append(transition.astype(np.float32))
        if under_way:
            self.current.add(step, reward)
            self.total_steps += 1
        return reward
