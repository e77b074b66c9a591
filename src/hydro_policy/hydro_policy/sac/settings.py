# SPDX-License-Identifier: Apache-2.0
"""Settings of Soft Actor-Critic, without numba, which takes a second to import."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hydro_core.settings import quantity


@dataclass(frozen=True, kw_only=True)
class SacSettings:
    """Settings of the algorithm (paper Table training_agent, where it gives a value)."""

    hidden_size: Annotated[int, quantity("-", 1, 1024)] = 32
    """Units in each of the two hidden layers of the actor and of each critic."""
    actor_learning_rate: Annotated[float, quantity("-", 1e-7, 0.1)] = 1e-3
    """Adam's step size for the actor."""
    critic_learning_rate: Annotated[float, quantity("-", 1e-7, 0.1)] = 1e-3
    """Adam's step size for the critics."""
    gamma: Annotated[float, quantity("-", 0.0, 0.99999)] = 0.99
    """Discount: what a reward one step later is worth; 0.99 at 100 Hz looks about 1 s ahead."""
    tau: Annotated[float, quantity("-", 1e-6, 1.0)] = 0.005
    """Polyak averaging: share by which the target critics move to the critics at each update."""
    initial_entropy_coefficient: Annotated[float, quantity("-", 1e-6, 10.0)] = 0.005
    """alpha at the start: what a nat of entropy is worth in reward."""
    entropy_learning_rate: Annotated[float, quantity("-", 0.0, 0.1)] = 1e-3
    """Adam's step size for log(alpha); 0 keeps alpha fixed."""
    target_entropy: Annotated[float, quantity("-", -10.0, 2.0)] = -2.0
    """Entropy in nats that alpha is steered to; minus the number of actions is usual."""
    batch_size: Annotated[int, quantity("-", 1, 512)] = 256
    """Transitions per update; as many as a buffer of the kernels holds at most."""
    reward_scale: Annotated[float, quantity("-", 1e-6, 100.0)] = 0.02
    """Factor on the reward before learning, so that the critics' values are of order one to a hundred."""
    log_std_min: Annotated[float, quantity("-", -20.0, 0.0)] = -5.0
    """Lower bound of the logarithm of the policy's standard deviation."""
    log_std_max: Annotated[float, quantity("-", 0.0, 4.0)] = 2.0
    """Upper bound of the same."""
    seed: Annotated[int, quantity("-", 0, 9e15)] = 0
    """Seed of the initial weights, and of the batches and the noise of updates."""
