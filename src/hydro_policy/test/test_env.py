# SPDX-License-Identifier: Apache-2.0
"""The Gymnasium environment is the inner one, and what other learners learn on it is deployed as it is or refused."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import skrl.agents.torch.sac as skrl_sac
import torch
from gymnasium.utils.env_checker import check_env
from skrl.resources.preprocessors.torch import RunningStandardScaler
from skrl.utils.model_instantiators.torch import deterministic_model, gaussian_model
from stable_baselines3 import PPO, SAC, TD3
from stable_baselines3.common.env_checker import check_env as check_for_baselines
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize
from torch import nn

from hydro_policy.env import ENVIRONMENT_ID
from hydro_policy.envs.environment import Environment
from hydro_policy.envs.vector_env import VectorBench
from hydro_policy.sac.policy import load_policy
from hydro_policy.task.mdp import OBSERVATION_SIZE, TaskSettings, events
from hydro_sim.files.pairing import BoxIdentity, mismatch, read_provenance
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant
from tests.checks import ran

TOO_HIGH = {"amplitude": 900.0, "frequency": 1.0}
"""N, above the box's limit: it trips within some steps."""


@pytest.mark.parametrize("law", ["paper", "wide", "compensated"])
@pytest.mark.filterwarnings("ignore:.*Box observation space m.* value is")
def test_checkers_of_gymnasium_and_stable_baselines3_pass(law: str) -> None:
    environment = gymnasium.make(ENVIRONMENT_ID, law=law, randomise=law == "wide")
    check_env(environment.unwrapped)
    check_for_baselines(environment.unwrapped)


def test_the_environment_is_made_by_its_module_and_refuses_an_action_that_is_no_number() -> None:
    code = 'import gymnasium; gymnasium.make("hydro_policy.env:hydro/ForceControl-v0").reset(seed=1)'
    assert ran(sys.executable, "-c", code).returncode == 0
    environment = gymnasium.make(ENVIRONMENT_ID)
    environment.reset(seed=1)
    with pytest.raises(ValueError, match="an action is not a number"):
        environment.step(np.array([np.nan, 0.0], np.float32))


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@pytest.mark.parametrize(
    "options",
    [{"law": "wide", "randomise": True}, {"law": "compensated"}, {"law": "wide", "reference": TOO_HIGH}],
    ids=str,
)
def test_benches_of_make_vec_are_single_environments_to_the_bit(options: dict[str, Any], mode: str) -> None:
    """Their episodes are truncated, or trips terminate them with the penalty."""
    benches = gymnasium.make_vec(ENVIRONMENT_ID, num_envs=3, max_episode_steps=25, autoreset_mode=mode, **options)
    make = [lambda: gymnasium.make(ENVIRONMENT_ID, max_episode_steps=25, **options)] * 3
    singles = gymnasium.vector.SyncVectorEnv(make, autoreset_mode=mode)
    np.testing.assert_array_equal(benches.reset(seed=4)[0], singles.reset(seed=4)[0])
    rng, ended = np.random.default_rng(0), np.zeros(2, int)
    for _ in range(55):
        actions = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        (*got, info), (*want, their_info) = benches.step(actions), singles.step(actions)
        for mine, theirs in zip(got, want, strict=True):
            np.testing.assert_array_equal(mine, theirs)
        assert info.keys() == their_info.keys()
        observation, reward, terminated, truncated = got
        assert np.isfinite(observation).all() and (reward[terminated] == -100.0).all()
        ended += terminated.sum(), truncated.sum()
    assert (ended > 0).tolist() == ([True, False] if "reference" in options else [False, True])


def test_episode_is_that_of_the_inner_environment() -> None:
    """Of pretraining's, of the same number and seed."""
    environment, task, bench = gymnasium.make(ENVIRONMENT_ID), TaskSettings(), Bench.nominal()
    inner = Environment(VectorBench([bench], [AnalyticPlant(bench)]), task)
    seen = environment.reset(seed=7)[0], environment.reset()[0]
    for episode in (0, 1):
        first = inner.reset([events.reference(task, episode, 7)], [events.stream_seed(7, episode, events.NOISE_STREAM)])
        np.testing.assert_array_equal(seen[episode], first[0].astype(np.float32))
    for action in np.random.default_rng(1).uniform(-1, 1, (20, 2)).astype(np.float32):
        observation, reward, *_ = environment.step(action)
        made = inner.step(action[np.newaxis].astype(float))
        np.testing.assert_array_equal(observation, made.next_observation[0].astype(np.float32))
        assert reward == made.reward[0]
    assert environment.spec is not None and environment.spec.max_episode_steps == 1800


def skrl_agent(environment: Any, output: str = "tanh(ACTIONS)") -> Any:
    """An agent as initialised, whose scaler of observations has seen some."""
    spaces = {"observation_space": environment.observation_space, "action_space": environment.action_space}
    net = [{"name": "net", "input": "OBSERVATIONS", "layers": [32, 32], "activations": "relu"}]
    both = [{**net[0], "input": "concatenate([OBSERVATIONS, ACTIONS])"}]
    critics = ("critic_1", "critic_2", "target_critic_1", "target_critic_2")
    models = {name: deterministic_model(**spaces, device="cpu", network=both, output="ONE") for name in critics}
    models["policy"] = gaussian_model(**spaces, device="cpu", network=net, output=output)
    cfg = skrl_sac.SAC_CFG(
        observation_preprocessor=RunningStandardScaler,
        observation_preprocessor_kwargs={"size": environment.observation_space},
    )
    agent = skrl_sac.SAC(models=models, cfg=cfg, device="cpu", **spaces)
    agent.act(torch.zeros(1, OBSERVATION_SIZE), None, timestep=1, timesteps=1)  # makes its layers
    agent._observation_preprocessor.running_mean += 0.3
    agent._observation_preprocessor.running_variance *= 4.0
    return agent


def baseline(environment: Any, kind: Any = SAC, **options: Any) -> Any:
    """A model as initialised, whose wrapper has seen some observations."""
    wrapper = VecNormalize(DummyVecEnv([lambda: environment]))
    model = kind("MlpPolicy", wrapper, policy_kwargs={"net_arch": [32, 32]} | options, device="cpu", seed=1)
    wrapper.reset()
    for _ in range(20):
        wrapper.step(np.full((1, 2), 0.5, np.float32))
    return model


def test_what_is_deployed_acts_as_the_learner_did_normalisation_included(tmp_path: Path) -> None:
    environment, path = gymnasium.make(ENVIRONMENT_ID, law="wide"), tmp_path / "policy.safetensors"
    drawn = np.random.default_rng(3).standard_normal((50, 13)).astype(np.float32)
    for kind in (SAC, TD3):
        model = baseline(environment, kind)
        environment.unwrapped.save_policy(model, path)
        observations = model.get_vec_normalize_env().unnormalize_obs(drawn)
        wanted = model.predict(drawn, deterministic=True)[0]
        np.testing.assert_allclose(load_policy(path)[0].act(observations), wanted, atol=1e-5)
    agent = skrl_agent(environment)
    environment.unwrapped.save_policy(agent, path)
    policy, gains, _ = load_policy(path)
    with torch.no_grad():
        wanted = agent.act(torch.as_tensor(drawn), None, timestep=1, timesteps=1)[1]["mean_actions"].numpy()
    np.testing.assert_allclose(policy.act(drawn), wanted, atol=1e-5)
    assert gains.delta_kp_max == 285.0
    assert mismatch("it", read_provenance(path), BoxIdentity.of_file(None, (15.0, 5.0)), "") == ""


def test_what_cannot_be_deployed_is_refused_in_a_sentence(tmp_path: Path) -> None:
    environment, path = gymnasium.make(ENVIRONMENT_ID), tmp_path / "policy.safetensors"
    refused = {
        "not squashed": baseline(environment, PPO),
        "not tanh": baseline(environment, activation_fn=nn.Tanh),
        "two equal hidden layers": baseline(environment, net_arch=[32, 16]),
        "not tanh of a perc": skrl_agent(environment, "ACTIONS"),
        "neither a model": nn.ReLU(),
    }
    for words, learner in refused.items():
        with pytest.raises(ValueError, match=words):
            environment.unwrapped.save_policy(learner, path)
    with pytest.raises(ValueError, match="paper's law"):
        gymnasium.make(ENVIRONMENT_ID, law="compensated").unwrapped.save_policy(baseline(environment), path)
    assert not path.exists()
