# SPDX-License-Identifier: Apache-2.0
"""Settings of Soft Actor-Critic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

from hydro_core.settings import quantity


@dataclass(frozen=True, kw_only=True)
class SacSettings:
    """Settings of the algorithm (paper Table training_agent, where it gives a value)."""

    hidden_size: Annotated[int, quantity("-", 1, 1024, "Units in each of the two hidden layers of all networks")] = 32
    actor_learning_rate: Annotated[float, quantity("-", 1e-7, 0.1, "Adam's step size for the actor")] = 1e-3
    critic_learning_rate: Annotated[float, quantity("-", 1e-7, 0.1, "Adam's step size for the critics")] = 1e-3
    gamma: Annotated[float, quantity("-", 0.0, 0.99999, "Discount per step; 0.99 at 100 Hz looks 1 s ahead")] = 0.99
    tau: Annotated[float, quantity("-", 1e-6, 1.0, "Polyak averaging: share of an update in the targets")] = 0.005
    initial_entropy_coefficient: Annotated[
        float, quantity("-", 1e-6, 10.0, "alpha at the start: what a nat of entropy is worth in reward")
    ] = 0.005
    entropy_learning_rate: Annotated[float, quantity("-", 0.0, 0.1, "Adam's step size for log(alpha); 0: fixed")] = 1e-3
    target_entropy: Annotated[
        float, quantity("-", -10.0, 2.0, "Entropy in nats that alpha is steered to; usual: minus the actions")
    ] = -2.0
    batch_size: Annotated[int, quantity("-", 2, 65536, "Transitions per update")] = 256
    reward_scale: Annotated[float, quantity("-", 1e-6, 100.0, "Factor on rewards; values are then 1 to 100")] = 0.02
    log_std_min: Annotated[float, quantity("-", -20.0, 0.0, "Lower bound of the log standard deviation")] = -5.0
    log_std_max: Annotated[float, quantity("-", 0.0, 4.0, "Upper bound of the same")] = 2.0
    seed: Annotated[int, quantity("-", 0, 9e15, "Of the initial weights, batches and noise of updates")] = 0
