# SPDX-License-Identifier: Apache-2.0
"""Statistics of an episode and of a run."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

import numpy as np

from hydro_policy.task.mdp import REFERENCE_RATE
from hydro_policy.task.step_aggregator import Step

SETTLING_STEPS = 50
"""Initial steps of an episode excluded from its RMSE: the references' cross-fade takes 0.3 s."""


class Phase(IntEnum):
    """Values of `TrainingStatus.phase`."""

    WAITING = 0
    TRAINING = 1
    EVALUATING = 2
    PAUSED = 3
    FINISHED = 4


@dataclass(kw_only=True)
class EpisodeRecord:
    """Sums over one episode."""

    episode: int
    amplitude: float = 0.0
    frequency: float = 0.0
    steps: int = 0
    episode_return: float = 0.0
    whole_steps: int = 0
    square_error: float = 0.0
    square_rate: float = 0.0
    samples: int = 0
    overridden_steps: int = 0

    def add(self, step: Step, reward: float) -> None:
        """Add one step."""
        self.steps += 1
        self.whole_steps += step.whole
        self.episode_return += reward
        if self.steps > SETTLING_STEPS:
            self.square_error += float(np.dot(step.error, step.error))
            self.square_rate += float(step.sample[REFERENCE_RATE]) ** 2 * len(step.error)
            self.samples += len(step.error)

    @property
    def force_rmse(self) -> float:
        """Force RMSE [N] after settling; NaN before."""
        return math.sqrt(self.square_error / self.samples) if self.samples else math.nan

    @property
    def lag(self) -> float:
        """RMSE over the RMS of f_r' [s]: comparable between references, since the error is mostly a lag."""
        return math.sqrt(self.square_error / self.square_rate) if self.square_rate else math.inf

    def summary(self) -> dict[str, float]:
        """Return the episode's summary for records."""
        return {
            "episode": self.episode,
            "amplitude": self.amplitude,
            "frequency": self.frequency,
            "return": self.episode_return,
            "force_rmse": self.force_rmse,
            "lag": self.lag,
            "whole_steps": self.whole_steps,
            "overridden_steps": self.overridden_steps,
        }


@dataclass
class Progress:
    """Progress of a run; part of the checkpoint."""

    episode: int = 0
    """Episodes finished."""
    total_steps: int = 0
    interruptions: int = 0
    last_return: float = math.nan
    last_rmse: float = math.nan
    best_lag: float = math.inf
    rollbacks: int = 0
    examined: int = -1
    """Finished episodes at the last examination; -1: none yet."""
    reference_rmse: list[float] = field(default_factory=list)
    """RMSE [N] of the fixed gains that scores are relative to, one per sine; empty until they are examined."""
    best_score: float = math.inf
    """Score of the best policy so far: mean over the sines of its RMSE over the reference's."""
    passed_at: int = -1
    """Finished episodes when a policy first beat the reference at every sine; -1: not yet."""
    exams: list[dict[str, Any]] = field(default_factory=list)
    history: list[dict[str, float]] = field(default_factory=list)
