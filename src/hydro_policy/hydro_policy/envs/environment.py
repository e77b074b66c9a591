# SPDX-License-Identifier: Apache-2.0
"""Environment of the task on a fleet of benches: observations, actions, rewards; each episode starts from rest.

The counterpart of `TrainingSession` for many benches and without the graph's interruptions: observation, reward, gains
and penalty are computed by the same functions of `task`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import STATE_FIELDS, Flag, FloatArray, ReferenceSignal, StateArray
from hydro_policy.envs.vector_env import VectorBench, records
from hydro_policy.task.mdp import ACTIONS, TaskSettings, observe


@dataclass(frozen=True)
class Transitions:
    """Transitions of one step of all benches; first axis: bench."""

    observation: FloatArray
    """Observations acted upon, shape (n, 13)."""
    action: FloatArray
    """Shape (n, 2)."""
    reward: FloatArray
    """Shape (n,)."""
    following: FloatArray
    """Next observations, shape (n, 13)."""
    terminated: npt.NDArray[np.bool_]
    """Whether the box tripped and its bench was reset, shape (n,)."""
    samples: StateArray
    """The ten samples, shape (n, 10)."""

    def rows(self) -> npt.NDArray[np.float32]:
        """Return rows of the replay buffer, shape (n, width), without those that hold a non-finite value."""
        last = np.stack((self.reward, self.terminated), axis=1)
        rows = np.concatenate((self.observation, self.following, self.action, last), axis=1)
        return rows[np.isfinite(rows).all(axis=1)].astype(np.float32)


class Environment:
    """A fleet of benches with observations and rewards.

    `fleet`: the benches. `task`: observation, reward, gains.
    """

    def __init__(self, fleet: VectorBench, task: TaskSettings) -> None:
        self.fleet, self.task = fleet, task
        self.observation: FloatArray = np.zeros((len(fleet), 0))
        self._references: list[ReferenceSignal] = []
        self._seeds: npt.NDArray[np.int64] = np.zeros(len(fleet), np.int64)

    def begin(self, references: Sequence[ReferenceSignal], seeds: Sequence[int]) -> FloatArray:
        """Start a new episode on every bench, from rest; returns the observations, shape (n, 13)."""
        self._references, self._seeds = list(references), np.array(seeds, np.int64)
        for index, reference in enumerate(references):
            self.fleet.begin(index, reference, int(seeds[index]))
        self.observation = observe(self._last(), np.zeros((len(self.fleet), ACTIONS)), self.task.size)
        return self.observation

    def step(self, actions: FloatArray) -> Transitions:
        """Advance ten samples under `actions`, shape (n, 2)."""
        before = self.observation
        samples = self.fleet.step(self.task.gains.changes(actions)).copy()
        error = samples["reference_force"] - samples["load_force"]
        error_rate = samples["reference_force_rate"] - samples["load_force_rate"]
        tripped = (samples["flags"][:, -1] & Flag.TRIPPED) != 0
        reward = np.where(tripped, -self.task.trip_penalty, self.task.rewards(error, error_rate))
        following = observe(self._last(), actions, self.task.size)
        self.observation = following.copy()
        if tripped.any():
            self._begin_tripped(tripped, following)
        return Transitions(before, actions, reward, following, tripped, samples)

    def _begin_tripped(self, tripped: npt.NDArray[np.bool_], following: FloatArray) -> None:
        """Reset the tripped benches; a terminal transition's next observation is unused, so any finite one will do."""
        for index in np.flatnonzero(tripped):
            self._seeds[index] += 1
            self.fleet.begin(int(index), self._references[index], int(self._seeds[index]))
            after = observe(self._last()[index], np.zeros(ACTIONS), self.task.size)
            self.observation[index] = after
            if not np.isfinite(following[index]).all():
                following[index] = after

    def _last(self) -> FloatArray:
        """Return the last samples, shape (n, 14), in the order of `STATE_FIELDS`."""
        return records(self.fleet.samples[:, -1], STATE_FIELDS)
