# SPDX-License-Identifier: Apache-2.0
"""Conversion of policies trained by stable-baselines3 or skrl on the Gymnasium environment to the deployed `Policy`.

Supported are actors whose mean action is tanh of a perceptron with two equal hidden layers of ReLU, as those of SAC
(and of TD3 and DDPG). A normalisation of observations is folded into the first layer::

    (o - m) / s W + b  =  o (W / s) + (b - (m / s) W)

A converted policy is compared with the learner's own mean action on random observations before it is returned: other
activations, a mean that is clipped in place of squashed, or further inputs are refused there.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_core.bench_scales import BenchScales
from hydro_core.signals import FloatArray
from hydro_policy.sac.policy import Policy
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import ACTION_SIZE, OBSERVATION_SIZE

LOG_STD_BOUNDS = (-20.0, 2.0)
"""Bounds of log sigma in stable-baselines3's SAC; skrl's models state theirs."""

ACTION_TOLERANCE = 1e-4
"""Largest difference of actions that is accepted; the learner's float32 causes some 1e-6 against float64 here."""

ActFunction = Callable[[FloatArray], Any]


def policy_of(learner: Any, size: BenchScales) -> Policy:
    """Convert a model of stable-baselines3 or an agent of skrl to a deployable policy.

    A normalising wrapper's clipping of observations, many deviations from their mean, is left out.

    Raises ValueError: the policy cannot be deployed; the message is the reason.
    """
    baseline = hasattr(learner, "get_vec_normalize_env")
    actor, center, scale, bounds, act = _of_baselines(learner) if baseline else _of_skrl(learner)
    layers = _layers(actor)
    shapes = [weight.shape for weight, _ in layers]
    hidden = shapes[0][1]
    if shapes != [(OBSERVATION_SIZE, hidden), (hidden, hidden), (hidden, 2 * ACTION_SIZE)]:
        sizes = " to ".join(str(count) for count in (shapes[0][0], *(shape[1] for shape in shapes)))
        raise ValueError(f"an actor of {sizes} units cannot be deployed: give it two equal hidden layers")
    (weight, bias), *rest = layers
    layers = [(weight / scale[:, np.newaxis], bias - (center / scale) @ weight), *rest]
    policy = Policy(SacSettings(hidden_size=hidden, log_std_min=bounds[0], log_std_max=bounds[1]), size)
    policy.load_flat(np.concatenate([array.ravel() for layer in layers for array in layer]))
    observations = center + scale * np.random.default_rng(0).standard_normal((256, OBSERVATION_SIZE))
    difference = float(np.abs(policy.act(observations) - act(observations)).max())
    if not difference < ACTION_TOLERANCE:
        raise ValueError("the mean action is not tanh of a perceptron: give its hidden layers ReLU, its end tanh")
    return policy


def _of_baselines(model: Any) -> tuple[Any, FloatArray, FloatArray, tuple[float, float], ActFunction]:
    """Return actor, normalisation (mean, deviation), bounds of log sigma, and mean action of a baselines model."""
    actor, wrapper = getattr(model, "actor", None), model.get_vec_normalize_env()
    if actor is None:
        raise ValueError(f"the mean action of {type(model).__name__} is not squashed by tanh: train SAC, TD3 or DDPG")
    center, scale = np.zeros(OBSERVATION_SIZE), np.ones(OBSERVATION_SIZE)
    if normalised := wrapper is not None and wrapper.norm_obs:
        center, scale = wrapper.obs_rms.mean, np.sqrt(wrapper.obs_rms.var + wrapper.epsilon)

    def act(observations: FloatArray) -> Any:
        seen = wrapper.normalize_obs(observations) if normalised else observations
        return model.predict(seen.astype(np.float32), deterministic=True)[0]

    return actor, center, scale, LOG_STD_BOUNDS, act


def _of_skrl(agent: Any) -> tuple[Any, FloatArray, FloatArray, tuple[float, float], ActFunction]:
    """Return actor, normalisation (mean, deviation), bounds of log sigma, and mean action of a skrl agent."""
    torch = sys.modules["torch"]  # imported with the agent; nothing here needs it
    actor, scaler = getattr(agent, "policy", None), getattr(agent, "_observation_preprocessor", None)
    if actor is None or scaler is None:
        raise ValueError(f"{type(agent).__name__} is neither a model of stable-baselines3 nor an agent of skrl")
    center, scale = np.zeros(OBSERVATION_SIZE), np.ones(OBSERVATION_SIZE)
    if hasattr(scaler, "running_mean"):
        center = scaler.running_mean.cpu().numpy()
        scale = np.sqrt(scaler.running_variance.cpu().numpy()) + scaler.epsilon
    bounds = float(getattr(actor, "_g_min_log_std", LOG_STD_BOUNDS[0])), float(getattr(actor, "_g_max_log_std", 2.0))

    def act(observations: FloatArray) -> Any:
        with torch.no_grad():
            seen = scaler(torch.as_tensor(observations, dtype=torch.float32, device=actor.device))
            return actor.act({"observations": seen}, role="policy")[1]["mean_actions"].cpu().numpy()

    return actor, center, scale, bounds, act


def _layers(actor: Any) -> list[tuple[FloatArray, FloatArray]]:
    """Return (weight [in, out], bias [out]) of the linear layers, heads of mean and log sigma as one layer.

    Where sigma is a parameter, or there is none, it becomes the head's bias.
    """
    linear = [part for part in actor.modules() if type(part).__name__ == "Linear"]
    found = [
        (part.weight.detach().cpu().numpy().T.astype(np.float64), part.bias.detach().cpu().numpy().astype(np.float64))
        for part in linear
    ]
    if len(found) > 3 and found[-1][0].shape == found[-2][0].shape:
        mean, log_std = found[-2:]
        found[-2:] = [(np.hstack((mean[0], log_std[0])), np.concatenate((mean[1], log_std[1])))]
    elif found[-1][0].shape[1] == ACTION_SIZE:
        weight, bias = found[-1]
        parameter = getattr(actor, "log_std_parameter", None)
        sigma = LOG_STD_BOUNDS[:1] * ACTION_SIZE if parameter is None else parameter.detach().cpu().numpy().ravel()
        found[-1] = np.hstack((weight, np.zeros_like(weight))), np.concatenate((bias, sigma))
    return found
