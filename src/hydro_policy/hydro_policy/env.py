# SPDX-License-Identifier: Apache-2.0
"""Force control as a Gymnasium environment for other RL libraries; importing it registers `hydro/ForceControl-v0`.

::

    env = gymnasium.make("hydro_policy.env:hydro/ForceControl-v0", law="wide", randomise=True)
    envs = gymnasium.make_vec("hydro_policy.env:hydro/ForceControl-v0", num_envs=8)  # one compiled loop over all
    env.unwrapped.save_policy(model, "policy.safetensors")                           # for deployment

Observations, actions, rewards and terminations are those of trainer and pretraining (`task.mdp`); episodes start from
rest. A trip terminates; 1800 steps of 10 ms truncate. Requires gymnasium, which no other module of the package imports.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, get_args

import gymnasium
import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Box
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

from hydro_core.bench_scales import rescale
from hydro_core.settings import SettingsError, from_mapping
from hydro_core.signals import Law
from hydro_policy.envs.environment import Environment, Episodes
from hydro_policy.envs.simulation import SimulationSetup
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.sac.peers import policy_of
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE, GainRange, TaskSettings, events
from hydro_sim.excitation import Reference
from hydro_sim.model.bench import NOMINAL

ENVIRONMENT_ID = "hydro/ForceControl-v0"

LawName = Literal["paper", "wide", "compensated"]

Float32Array = npt.NDArray[np.float32]
BoolArray = npt.NDArray[np.bool_]


class ForceControlVector(gymnasium.vector.VectorEnv[Float32Array, Float32Array, npt.NDArray[Any]]):
    """Vectorised force-control environment in one compiled loop; bench i of seed s is `ForceControl` of seed s + i.

    Parameters
    ----------
    num_envs
        Number of benches.
    bench
        Bench file to simulate, a diagnosis' corrected.yaml for instance; `shipped`: the learned bench; None: the
        nominal one.
    box
        Bench file assumed by the boxes' force law; None: the nominal bench, whatever is simulated.
    law
        `paper` or `wide`: gains and reward of pretraining's configuration of that name. `compensated`: full gain range
        of the box's compensated law, with coefficients estimated online, and the reward of `wide`.
    reference
        `random`: a new sine in each episode, of 2/3 to 1 of the bench's force scale and 0.5 to 2 Hz; or the fields of a
        reference: waveform (hold, sine, multisine, smooth_step), amplitude [N], offset [N], frequency [Hz], phase
        [rad].
    randomise
        Randomise the bench's parameters around those of `bench`, in all but an eighth of the episodes.
    max_episode_steps
        Policy steps of 10 ms after which an episode is truncated; None: never.
    autoreset_mode
        Gymnasium's `AutoresetMode`: when a bench starts the next episode after the end of one.

    Raises ValueError: a file or a setting is invalid.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        bench: str | Path | None = None,
        box: str | Path | None = None,
        law: LawName = "paper",
        reference: Literal["random"] | Mapping[str, Any] = "random",
        randomise: bool = False,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
    ) -> None:
        self.autoreset_mode = AutoresetMode(autoreset_mode)
        self.metadata = {"render_modes": [], "autoreset_mode": self.autoreset_mode}
        source = SimulationSetup(
            model=str(bench or "analytic"), box=None if box is None else str(box), randomise=randomise
        )
        box_bench, config = source.box_bench(), source.box_config()
        if law not in get_args(LawName):
            raise SettingsError(f"law is one of {', '.join(get_args(LawName))}, not {law!r}")
        name = "paper" if law == "paper" else "wide"
        task = configuration(name, base=(config.base_kp, config.base_ki), size=box_bench.size).task
        task = task if law != "compensated" else replace(task, gains=GainRange.enclosing(config.compensated))
        self.simulation, self.law, self.task = source, law, task
        fixed = reference != "random"
        self._reference = from_mapping(Reference, reference, "reference").signal if fixed else None
        ranges = rescale(events.Randomisation(), NOMINAL, box_bench.size) if randomise else None
        self._episodes = Episodes(source=source.simulated(), box_bench=box_bench, randomisation=ranges)
        vector_bench = VectorBench([box_bench] * num_envs, [self._episodes.plant() for _ in range(num_envs)], config)
        self._environment = Environment(vector_bench, self.task, Law.COMPENSATED if law == "compensated" else Law.PAPER)
        self.num_envs, self._limit = num_envs, max_episode_steps
        self.single_observation_space = Box(-np.inf, np.inf, (OBSERVATION_SIZE,), np.float32)
        self.single_action_space = Box(-1.0, 1.0, (ACTION_SIZE,), np.float32)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seeds = [int(seed) for seed in self.np_random.integers(2**31, size=num_envs)]
        self._episode = np.zeros(num_envs, np.int64)
        self._steps = np.zeros(num_envs, np.int64)
        self._ended: BoolArray = np.zeros(num_envs, bool)

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start new episodes on all benches, or on those of the mask `options["reset_mask"]`, shape (n,).

        `seed`: seed of references, benches and noise, `seed` + i on bench i, or one seed per bench; None: the next
        episode of the present seed.
        """
        seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int) else seed or [None] * self.num_envs
        chosen = (options or {}).get("reset_mask", np.ones(self.num_envs, bool))
        for index in np.flatnonzero(chosen):
            if (new := seeds[index]) is not None:
                self._seeds[index], self._episode[index] = new, 0
            self._start_episode(int(index))
        self._ended &= ~chosen
        return self._environment.observation.astype(np.float32), {}

    def step(
        self, actions: Float32Array
    ) -> tuple[Float32Array, npt.NDArray[Any], BoolArray, BoolArray, dict[str, Any]]:
        """Advance all benches by 10 ms; `actions`, shape (n, 2), are clamped to [-1, 1]. Raises ValueError for NaN."""
        if np.isnan(actions).any():
            raise ValueError("an action is not a number: the learner has diverged")
        made = self._environment.step(np.clip(np.asarray(actions, np.float64), -1.0, 1.0), restart=False)
        self._steps += 1
        observation, reward, terminated = made.next_observation.astype(np.float32), made.reward, made.terminated
        truncated: BoolArray = self._steps >= (np.inf if self._limit is None else self._limit)
        info: dict[str, Any] = {}
        begins: BoolArray = np.zeros(self.num_envs, bool)
        if self.autoreset_mode is AutoresetMode.NEXT_STEP:
            begins = self._ended
            reward, terminated, truncated = np.where(begins, 0.0, reward), terminated & ~begins, truncated & ~begins
        elif self.autoreset_mode is AutoresetMode.SAME_STEP:
            begins = terminated | truncated
            for index in np.flatnonzero(begins):
                info = self._add_info(info, {"final_obs": observation[index].copy(), "final_info": {}}, int(index))
        for index in np.flatnonzero(begins):
            self._start_episode(int(index))
            observation[index] = self._environment.observation[index]
        self._ended = terminated | truncated
        return observation, reward, terminated, truncated, info

    def save_policy(self, learner: Any, path: str | Path) -> None:
        """Write the policy of a stable-baselines3 or skrl learner to a policy file for `evaluate --policy`.

        Raises ValueError: the policy cannot be deployed (`sac.peers.policy_of`), or the law is `compensated`.
        """
        if self.law == "compensated":
            raise ValueError("a policy is deployed under the paper's law: train it with law paper or wide")
        policy = policy_of(learner, self.task.size)
        notes: dict[str, object] = {"learner": type(learner).__module__, "law": self.law}
        policy.save(Path(path), self.task.gains, notes, self.simulation.provenance())

    def _start_episode(self, index: int) -> None:
        episode, seed = int(self._episode[index]), self._seeds[index]
        reference = self._reference or events.reference(self.task, episode, seed)
        environment = self._environment
        reference = self._episodes.install(environment.vector_bench, index, reference, episode, seed)
        environment.reset_one(index, reference, events.stream_seed(seed, episode, events.NOISE_STREAM))
        self._episode[index] += 1
        self._steps[index] = 0


class ForceControl(gymnasium.Env[Float32Array, Float32Array]):
    """Force-control environment of one bench; `options`: of `ForceControlVector`, but `num_envs`, `autoreset_mode`."""

    metadata = {"render_modes": []}  # noqa: RUF012

    def __init__(self, **options: Any) -> None:
        self.benches = ForceControlVector(autoreset_mode=AutoresetMode.DISABLED, **options)
        self.observation_space = self.benches.single_observation_space
        self.action_space = self.benches.single_action_space

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Float32Array, dict[str, Any]]:
        """Start a new episode: the first one of `seed`, or the next one of the present seed."""
        super().reset(seed=seed)
        return self.benches.reset(seed=seed)[0][0], {}

    def step(self, action: Float32Array) -> tuple[Float32Array, float, bool, bool, dict[str, Any]]:
        """Advance by 10 ms; `action`, shape (2,), is clamped to [-1, 1]. Truncation is gymnasium's (`TimeLimit`)."""
        observation, reward, terminated, truncated, info = self.benches.step(np.reshape(action, (1, ACTION_SIZE)))
        return observation[0], float(reward[0]), bool(terminated[0]), bool(truncated[0]), info

    def save_policy(self, learner: Any, path: str | Path) -> None:
        """Write a learner's policy to a file, as `ForceControlVector.save_policy`."""
        self.benches.save_policy(learner, path)


gymnasium.register(
    ENVIRONMENT_ID,
    f"{__name__}:{ForceControl.__name__}",
    vector_entry_point=f"{__name__}:{ForceControlVector.__name__}",
    max_episode_steps=TaskSettings().steps_per_episode,
)
