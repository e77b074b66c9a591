# SPDX-License-Identifier: Apache-2.0
"""Named configurations: `paper` is Table training_agent, `wide` the range allowed by the learned metric's filter."""

from __future__ import annotations

from dataclasses import replace

from hydro_core.bench_scales import BenchScales, rescale
from hydro_policy.runs.run_directory import TrainingSettings
from hydro_policy.sac.settings import SacSettings
from hydro_policy.task.mdp import BASE_GAINS, GainRange, TaskSettings
from hydro_sim.model.bench import NOMINAL

WIDE_GAINS = GainRange(delta_kp_max=285.0, delta_ki_max=95.0)  # K_p from 15 to 300, K_i from 5 to 100: the box's limits

WIDE_TASK = TaskSettings(gains=WIDE_GAINS, reward_power=1.0, error_rate_weight=20.0, trip_penalty=100.0)
"""Task of `wide`: root of the paper's reward with less weight on e', whose noise masks small errors of slow sines."""

CONFIGURATIONS = ("paper", "wide")


def configuration(
    name: str, seed: int = 0, base: tuple[float, float] = BASE_GAINS, size: BenchScales = NOMINAL
) -> TrainingSettings:
    """Return the training settings of one of `CONFIGURATIONS`, 160 episodes, for a bench of this size.

    The range of total gains is independent of the box's base gains.
    """
    task, sac = TaskSettings(), SacSettings(seed=seed)
    if name == "wide":
        task, sac = WIDE_TASK, replace(sac, reward_scale=0.2)
    gains = task.gains.shifted(BASE_GAINS[0] - base[0], BASE_GAINS[1] - base[1])
    return rescale(TrainingSettings(seed=seed, sac=sac, task=replace(task, gains=gains)), NOMINAL, size)
