# SPDX-License-Identifier: Apache-2.0
"""Four Soft Actor-Critics behind one face, with the paper's sizes and values: ours, stable-baselines3, SBX, skrl.

`train`: so many environment steps, an update after each from `STARTS` on, the product's `learning_starts`; `update`: so
many updates from what is in the buffer; `act`: the mean action. The task is `hydro_policy.env`: one bench on the
learned model.
"""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
import torch
from torch import nn

from hydro_core.signals import FloatArray
from hydro_policy.env import ENVIRONMENT_ID
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.sac.agent import ReplayBuffer
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.sac import Sac
from hydro_policy.sac.settings import SacSettings

STARTS, CAPACITY, HIDDEN = TrainingSettings().learning_starts, 100_000, (32, 32)
REWARD_SCALE = 0.02
"""As `SacSettings.reward_scale`; here in the environment, so that every learner sees the same rewards."""


def force_control(seed: int = 0, **options: Any) -> gymnasium.Env[Any, Any]:
    """Return the environment on the learned bench, at the first episode of a seed."""
    made = gymnasium.make(ENVIRONMENT_ID, bench="shipped", **options)
    scaled = gymnasium.wrappers.TransformReward(made, lambda reward: REWARD_SCALE * float(reward))
    scaled.reset(seed=seed)
    return scaled


class Ours:
    """`hydro_policy.sac.sac` in the loop that everybody has."""

    def __init__(self, batch: int, seed: int) -> None:
        self.sac = Sac(13, 2, SacSettings(batch_size=batch, reward_scale=1.0, seed=seed))
        self.replay, self.policy = ReplayBuffer(13, 2, CAPACITY), Policy(SacSettings(hidden_size=HIDDEN[0]))
        self.rng = np.random.default_rng(seed)

    def train(self, environment: gymnasium.Env[Any, Any], steps: int) -> None:
        self.policy.load_flat(self.sac.actor_parameters())
        observation, _ = environment.reset()
        for step in range(steps):
            action = self.policy.act(observation, self.rng)
            following, reward, terminated, over, _ = environment.step(action)
            row: FloatArray = np.concatenate((observation, following, action, (reward, float(terminated))))
            self.replay.extend(row[np.newaxis].astype(np.float32))
            observation = environment.reset()[0] if terminated or over else following
            if step >= STARTS:
                self.sac.learn(self.replay, 1)
                self.policy.load_flat(self.sac.actor_parameters())

    def update(self, count: int) -> None:
        self.sac.learn(self.replay, count)

    def act(self, observation: FloatArray) -> FloatArray:
        return self.policy.act(observation)


class Baselines:
    """stable-baselines3, or SBX, which has the same face.

    `module`: `stable_baselines3` or `sbx`.
    """

    def __init__(self, module: Any, batch: int, seed: int) -> None:
        self._kind, self._batch, self._seed = module.SAC, batch, seed
        self._model: Any = None
        self._options = {"net_arch": {"pi": list(HIDDEN), "qf": list(HIDDEN)}}
        if module.__name__ == "stable_baselines3":
            self._options["activation_fn"] = nn.ReLU  # type: ignore[assignment]

    def train(self, environment: gymnasium.Env[Any, Any], steps: int) -> None:
        if self._model is None:
            self._model = self._kind(
                "MlpPolicy", environment, learning_rate=1e-3, buffer_size=CAPACITY, learning_starts=STARTS,
                batch_size=self._batch, tau=0.005, gamma=0.99, train_freq=1, gradient_steps=1, ent_coef="auto_0.005",
                target_entropy=-2.0, policy_kwargs=self._options, seed=self._seed, verbose=0,
                **({"device": "cpu"} if "activation_fn" in self._options else {}),
            )  # fmt: skip
        self._model.learn(steps)

    def update(self, count: int) -> None:
        assert self._model is not None
        self._model.train(gradient_steps=count, batch_size=self._batch)

    def act(self, observation: FloatArray) -> FloatArray:
        assert self._model is not None
        return np.asarray(self._model.predict(observation, deterministic=True)[0])


class Skrl:
    """skrl, which the paper used; its Gaussian is not squashed but clipped, as in its own examples."""

    def __init__(self, batch: int, seed: int) -> None:
        from skrl.utils import set_seed

        set_seed(seed)
        self._batch, self._agent, self._steps = batch, None, 0

    def train(self, environment: gymnasium.Env[Any, Any], steps: int) -> None:
        from skrl.envs.wrappers.torch import wrap_env
        from skrl.trainers.torch import SequentialTrainer, SequentialTrainerCfg

        wrapped = wrap_env(environment, verbose=False)
        self._agent = self._agent or _skrl_agent(wrapped, self._batch)
        cfg = SequentialTrainerCfg(
            timesteps=steps, headless=True, disable_progressbar=True, close_environment_at_exit=False
        )
        SequentialTrainer(cfg=cfg, env=wrapped, agents=self._agent).train()

    def update(self, count: int) -> None:
        assert self._agent is not None
        self._agent.cfg.gradient_steps = count
        self._agent.enable_models_training_mode(True)
        self._agent.update(timestep=1, timesteps=1)
        self._agent.cfg.gradient_steps = 1

    def act(self, observation: FloatArray) -> FloatArray:
        assert self._agent is not None
        inputs = {"observations": torch.as_tensor(observation, dtype=torch.float32).unsqueeze(0)}
        with torch.no_grad():
            mean, _ = self._agent.policy.compute(inputs, "policy")
        return np.clip(mean[0].numpy(), -1.0, 1.0)


def _skrl_agent(wrapped: Any, batch: int) -> Any:
    from skrl.agents.torch.sac import SAC, SAC_CFG
    from skrl.memories.torch import RandomMemory
    from skrl.models.torch import DeterministicMixin, GaussianMixin, Model

    spaces = {"observation_space": wrapped.observation_space, "action_space": wrapped.action_space, "device": "cpu"}

    class Actor(GaussianMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            GaussianMixin.__init__(self, clip_actions=True, min_log_std=-5.0, max_log_std=2.0)
            self.net = _net(13, 4)

        def compute(self, inputs: Any, role: str = "") -> Any:
            mean, log_std = self.net(inputs["observations"]).chunk(2, dim=1)
            return torch.tanh(mean), {"log_std": log_std}

    class Critic(DeterministicMixin, Model):  # type: ignore[misc]
        def __init__(self) -> None:
            Model.__init__(self, **spaces)
            DeterministicMixin.__init__(self)
            self.net = _net(15, 1)

        def compute(self, inputs: Any, role: str = "") -> Any:
            return self.net(torch.cat((inputs["observations"], inputs["taken_actions"]), dim=1)), {}

    names = ("critic_1", "critic_2", "target_critic_1", "target_critic_2")
    cfg = SAC_CFG(
        batch_size=batch, learning_starts=STARTS, initial_entropy_value=0.005, target_entropy=-2.0,
        experiment={"write_interval": 0, "checkpoint_interval": 0},
    )  # type: ignore[arg-type] # fmt: skip
    memory = RandomMemory(memory_size=CAPACITY, num_envs=1, device="cpu")
    return SAC(models={"policy": Actor(), **{name: Critic() for name in names}}, memory=memory, cfg=cfg, **spaces)


def _net(inputs: int, outputs: int) -> nn.Module:
    first, second = HIDDEN
    return nn.Sequential(
        nn.Linear(inputs, first), nn.ReLU(), nn.Linear(first, second), nn.ReLU(), nn.Linear(second, outputs)
    )
