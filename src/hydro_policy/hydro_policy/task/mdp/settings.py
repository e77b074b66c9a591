# SPDX-License-Identifier: Apache-2.0
"""Settings of the task."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Annotated

from hydro_core.bench_scales import BenchScales
from hydro_core.settings import described, quantity
from hydro_policy.task.mdp.actions import GainRange
from hydro_sim.model.bench import NOMINAL


@dataclass(frozen=True, kw_only=True)
class TaskSettings:
    """Settings of the task: reward, gains, episodes (paper eq. reward, Table training_agent; units: physics.md)."""

    error_weight: Annotated[float, quantity("-", 0.0, 1e6, "Q_1, on the square of e / force_scale")] = 100.0
    error_rate_weight: Annotated[float, quantity("-", 0.0, 1e6, "Q_2, on the square of e' / force_rate_scale")] = 4000.0
    force_scale: Annotated[float, quantity("N", 1e-3, 1e7, "Of the error in the reward")] = NOMINAL.force
    force_rate_scale: Annotated[
        float, quantity("N/s", 1e-3, 1e8, "Of the error's rate in the reward: `force_scale` at 2 Hz")
    ] = NOMINAL.force * 2.0 * math.pi * 2.0
    reward_power: Annotated[
        float, quantity("-", 0.1, 2.0, "2: the paper's square; 1: its root, which weighs small errors more")
    ] = 2.0
    trip_penalty: Annotated[float, quantity("-", 0.0, 1e6, "Subtracted when the box trips: the episode's end")] = 1000.0
    steps_per_episode: Annotated[int, quantity("-", 10, 1e6, "Policy steps, 10 ms each")] = 1800
    amplitude_min: Annotated[float, quantity("N", 0.0, 1e7, "Smallest reference amplitude")] = NOMINAL.force * 2.0 / 3.0
    amplitude_max: Annotated[float, quantity("N", 0.0, 1e7, "Largest reference amplitude")] = NOMINAL.force
    frequency_min: Annotated[float, quantity("Hz", 0.05, 10.0, "Lowest frequency of a reference")] = 0.5
    frequency_max: Annotated[float, quantity("Hz", 0.05, 10.0, "Highest frequency of a reference")] = 2.0
    gains: GainRange = field(default_factory=GainRange)
    size: Annotated[BenchScales, described("Of the bench: what observations are scaled with")] = NOMINAL
