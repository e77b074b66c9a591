# SPDX-License-Identifier: Apache-2.0
"""Initial agent of a training on the bench: a pretrained one, with critics and temperature."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

from hydro_core.bench_scales import BenchScales, rescale
from hydro_policy.runs.run_directory import RunDirectory, TrainingSettings
from hydro_policy.sac.agent import Agent, settings_of
from hydro_policy.sac.policy import load_policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE, GainRange
from hydro_sim.files.pairing import Provenance, read_provenance
from hydro_sim.model.bench import NOMINAL

AGENT_FILE = "learner.safetensors"

REWARD_FIELDS = ("error_weight", "error_rate_weight", "force_scale", "force_rate_scale", "reward_power", "trip_penalty")
"""Fields of `TaskSettings` that define the reward."""


@dataclass(frozen=True)
class InitialAgent:
    """Pretrained agent from which a training starts, with the settings that it is valid for."""

    agent: bytes  # agent as returned by `Agent.dump`; its updates are counted from here
    sac: SacSettings  # settings of the algorithm that it was trained with
    gains: GainRange  # range of gains that its actions map to
    reward: dict[str, Any]
    """Reward that the agent was trained on, fields of `TaskSettings`: its critics are valid for no other."""
    source: Path
    made: Provenance | None = None  # box that it was made for; None: not recorded in its files
    size: BenchScales = NOMINAL  # of the bench that its reward is for

    def adapt_settings(self, settings: TrainingSettings) -> TrainingSettings:
        """Return the settings with this agent's network size, range of gains and reward.

        The agent is changed slowly: learning starts once the replay buffer holds an episode of the bench, and the
        actor's learning rate is a tenth of the original.
        """
        rate = 0.1 * settings.sac.actor_learning_rate
        kept = {name: getattr(self.sac, name) for name in ("hidden_size", "log_std_min", "log_std_max", "reward_scale")}
        sac = replace(settings.sac, actor_learning_rate=rate, **kept)
        reward = rescale(replace(settings.task, **self.reward), self.size, settings.task.size)
        task = replace(settings.task, gains=self.gains, **{name: getattr(reward, name) for name in self.reward})
        starts = max(settings.learning_starts, task.steps_per_episode)
        return replace(settings, sac=sac, task=task, learning_starts=starts)


def shipped_agent(authority: str) -> InitialAgent | None:
    """Return the pretrained agent shipped for a configuration; None if there is none."""
    folder = Path(str(resources.files("hydro_policy") / "data" / f"pretrained_{authority}"))
    return load_initial_agent(folder) if folder.is_dir() else None


def load_initial_agent(path: Path) -> InitialAgent:
    """Load the agent of a run's folder (its best, else its latest), or of any folder with agent and policy.

    Raises ValueError: there is no agent, or only a policy without critics, which cannot continue learning.
    """
    run = RunDirectory(path)
    folders = (path, run.best, run.latest)
    found = next((folder / AGENT_FILE for folder in folders if (folder / AGENT_FILE).is_file()), None)
    if found is None:
        raise ValueError(f"{path} holds no {AGENT_FILE}: name the folder of a run or of `pretrain`")
    try:
        content = found.read_bytes()
        sac = settings_of(content)
        agent = Agent(OBSERVATION_SIZE, ACTION_SIZE, sac)
        agent.restore(content)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{found} is not an agent: {error}") from error
    agent.updates = 0  # or its past updates would count as done for future transitions
    policy, gains, notes = load_policy(run.policy)
    task = notes.get("task")
    reward = {name: float(task[name]) for name in REWARD_FIELDS if name in task} if isinstance(task, dict) else {}
    return InitialAgent(
        agent.dump(), sac, gains, reward, path, read_provenance(found) or read_provenance(run.policy), policy.size
    )
