# SPDX-License-Identifier: Apache-2.0
"""What is saved is what was: algorithm, checkpoint, policy, settings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from hydro_policy.runs.initial_agent import AGENT, load_initial_agent
from hydro_policy.runs.run import RunDirectory, TrainingSettings, load_checkpoint, save_checkpoint
from hydro_policy.sac.algorithm import Sac
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.sac.replay import ReplayBuffer
from hydro_policy.sac.settings import SacSettings
from hydro_policy.sac.snapshot import actor_parameters, dump, restore, settings_of
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS, GainRange


def trained(updates: int) -> tuple[Sac, ReplayBuffer]:
    sac, replay = Sac(OBSERVATIONS, 2, SacSettings(seed=4, batch_size=32)), ReplayBuffer(OBSERVATIONS, 2, 300)
    rows = np.random.default_rng(0).normal(size=(200, 30)).astype(np.float32)
    rows[:, -1] = 0.0
    replay.extend(rows)
    sac.learn(replay, updates)
    return sac, replay


def test_resumed_training_is_the_same_bit_for_bit(tmp_path: Path) -> None:
    sac, replay = trained(20)
    save_checkpoint(tmp_path / "latest", dump(sac), replay, {"episode": 3})
    sac.learn(replay, 20)

    checkpoint = load_checkpoint(tmp_path / "latest")
    again, memory = Sac(OBSERVATIONS, 2, settings_of(checkpoint.learner)), ReplayBuffer(OBSERVATIONS, 2, 300)
    restore(again, checkpoint.learner)
    memory.restore(checkpoint.replay, checkpoint.produced)
    again.learn(memory, 20)
    assert again.updates == sac.updates == 40
    assert checkpoint.trainer == {"episode": 3}
    assert dump(again) == dump(sac)  # every network, moment, counter and the generator


def test_interrupted_writer_leaves_the_previous_checkpoint(tmp_path: Path) -> None:
    sac, replay = trained(1)
    save_checkpoint(tmp_path / "latest", dump(sac), replay, {"episode": 1})
    (tmp_path / "latest").rename(tmp_path / "latest.previous")  # as between the writer's two renames
    (tmp_path / "latest.partial").mkdir()
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 1}
    save_checkpoint(tmp_path / "latest", dump(sac), replay, {"episode": 2})
    assert load_checkpoint(tmp_path / "latest").trainer == {"episode": 2}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["latest"]


def test_numpy_policy_equals_the_torch_actor(tmp_path: Path) -> None:
    sac, _ = trained(50)
    policy = Policy(SacSettings())
    policy.load_flat(sac.actor_network.parameters.numpy())
    policy.save(tmp_path / "policy.safetensors", GainRange(delta_kp_max=285.0), {"episode": 7})
    loaded, gains, notes = load_policy(tmp_path / "policy.safetensors")
    assert gains == GainRange(delta_kp_max=285.0) and notes == {"episode": 7}
    observations = np.random.default_rng(1).normal(size=(500, OBSERVATIONS)).astype(np.float32)
    hidden, network = torch.from_numpy(observations), sac.actor_network
    for k, (weight, bias) in enumerate(zip(network.weights, network.biases, strict=True)):
        hidden = hidden @ weight[0] + bias[0]
        hidden = torch.relu(hidden) if k < 2 else hidden
    expected = torch.tanh(hidden[:, :2]).numpy()
    for actor in (policy, loaded):
        ours = np.stack([actor.act(row.astype(np.float64)) for row in observations])
        np.testing.assert_allclose(ours, expected, atol=1e-6, rtol=0)


def test_an_agent_to_start_from_brings_its_range_and_owes_no_updates_of_its_past(tmp_path: Path) -> None:
    settings = SacSettings(hidden_size=16, seed=5)
    sac = Sac(OBSERVATIONS, ACTIONS, settings)
    sac.updates = 280_000
    (tmp_path / AGENT).write_bytes(dump(sac))
    policy = Policy(SacSettings(hidden_size=16))
    policy.load_flat(actor_parameters(dump(sac)))
    policy.save(RunDirectory(tmp_path).policy, GainRange(delta_kp_max=285.0), {"task": {"trip_penalty": 100.0}})
    start = load_initial_agent(tmp_path)
    np.testing.assert_array_equal(actor_parameters(start.agent), actor_parameters(dump(sac)))
    again = Sac(OBSERVATIONS, ACTIONS, settings)
    restore(again, start.agent)
    assert again.updates == 0
    adopted = start.adopted(TrainingSettings())
    assert adopted.sac.hidden_size == 16 and adopted.task.trip_penalty == 100.0
    assert adopted.task.gains == GainRange(delta_kp_max=285.0)
    with pytest.raises(ValueError, match=r"holds no learner\.safetensors"):
        load_initial_agent(tmp_path / "nowhere")
    (tmp_path / AGENT).write_bytes(b"no agent")
    with pytest.raises(ValueError, match="is not an agent"):
        load_initial_agent(tmp_path)
