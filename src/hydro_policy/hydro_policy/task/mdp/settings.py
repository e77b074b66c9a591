# SPDX-License-Identifier: Apache-2.0
"""Settings of the task."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from hydro_core.bench_scales import BenchScales
from hydro_core.settings import quantity
from hydro_policy.task.mdp.actions import GainRange
from hydro_sim.model.bench import NOMINAL


@dataclass(frozen=True, kw_only=True)
class TaskSettings:
    """Settings of the task: reward, gains, episodes (paper eq. reward, Table training_agent; units: physics.md)."""

    error_weight: Annotated[float, quantity("-", 0.0, 1e6)] = 100.0
    """Q_1, on the square of e / force_scale."""
    error_rate_weight: Annotated[float, quantity("-", 0.0, 1e6)] = 4000.0
    """Q_2, on the square of e' / force_rate_scale."""
    force_scale: Annotated[float, quantity("N", 1e-3, 1e7)] = NOMINAL.force
    """Of the error in the reward."""
    force_rate_scale: Annotated[float, quantity("N/s", 1e-3, 1e8)] = NOMINAL.force * 2.0 * math.pi * 2.0
    """Of the error's rate in the reward: `force_scale` at 2 Hz."""
    reward_power: Annotated[float, quantity("-", 0.1, 2.0)] = 2.0
    """Of the reward: 2 is the paper's square, 1 its root, which weighs small errors on slow references more."""
    trip_penalty: Annotated[float, quantity("-", 0.0, 1e6)] = 1000.0
    """Taken from the reward when the box trips (force limit, sensor fault), which ends the episode."""
    steps_per_episode: Annotated[int, quantity("-", 10, 1e6)] = 1800
    """Policy steps, 10 ms each."""
    amplitude_min: Annotated[float, quantity("N", 0.0, 1e7)] = NOMINAL.force * 2.0 / 3.0
    """Smallest amplitude of a reference."""
    amplitude_max: Annotated[float, quantity("N", 0.0, 1e7)] = NOMINAL.force
    """Largest amplitude of a reference."""
    frequency_min: Annotated[float, quantity("Hz", 0.05, 10.0)] = 0.5
    """Lowest frequency of a reference."""
    frequency_max: Annotated[float, quantity("Hz", 0.05, 10.0)] = 2.0
    """Highest frequency of a reference."""
    gains: GainRange = field(default_factory=GainRange)
    size: BenchScales = NOMINAL
    """Of the bench: what observations are scaled with."""
