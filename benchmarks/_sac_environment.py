# SPDX-License-Identifier: Apache-2.0
"""The task as a gymnasium environment: one bench on the learned model, for the peers of `sac_peers`."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np

from hydro_bridge.signals import FloatArray, ReferenceSignal, Waveform
from hydro_policy.envs.environment import Environment
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS, TaskSettings
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.model.bench import Bench

REWARD_SCALE = 0.02
"""As `SacSettings.reward_scale`; here in the environment, so that every learner sees the same rewards."""


class HydroEnv(gymnasium.Env[FloatArray, FloatArray]):
    """Episodes of the paper: a sine of 200 to 300 N and 0.5 to 2 Hz from rest; truncated at their end.

    Parameters
    ----------
    seed
        Of references and noise.
    frequency
        Hz, the same always; None: as the task draws them.
    """

    def __init__(self, seed: int = 0, frequency: float | None = None, steps: int = 1800) -> None:
        self.task = TaskSettings(steps_per_episode=steps)
        self.observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (OBSERVATIONS,), np.float32)
        self.action_space = gymnasium.spaces.Box(-1.0, 1.0, (ACTIONS,), np.float32)
        self._environment = Environment(VectorBench([Bench.nominal()], [LearnedPlant()]), self.task)
        self._seed, self._frequency, self._episode, self._steps = seed, frequency, 0, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """A new episode."""
        super().reset(seed=seed)
        reference = self.task.reference(self._episode, self._seed)
        if self._frequency is not None:
            reference = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=self._frequency)
        self._episode, self._steps = self._episode + 1, 0
        return self._environment.begin([reference], [self._seed + self._episode])[0].astype(np.float32), {}

    def step(self, action: FloatArray) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Ten samples."""
        made = self._environment.step(np.asarray(action, np.float64).reshape(1, ACTIONS))
        self._steps += 1
        terminated, over = bool(made.terminated[0]), self._steps >= self.task.steps_per_episode
        return made.following[0].astype(np.float32), REWARD_SCALE * float(made.reward[0]), terminated, over, {}
