# SPDX-License-Identifier: Apache-2.0
"""Examining a policy between training episodes: what a few sines say of its mean action, relative to fixed gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from hydro_policy.evaluation.controllers import Controller, FixedGains, PolicyController
from hydro_policy.evaluation.session import EvaluationSession
from hydro_policy.sac.policy import Policy
from hydro_policy.supervision.monitor import SafetyMonitor
from hydro_policy.supervision.outputs import Outputs
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor
from hydro_policy.task.cases import ExamSettings
from hydro_policy.task.mdp import GainRange
from hydro_policy.task.scoring import Score

RETRIES = 2
"""Of a sine in which corrections came late: what it says is not the policy's doing."""

EXAMINED = "policy"
"""Name of the policy in an examination's scores."""


@dataclass(frozen=True)
class Surroundings:
    """What an examination shares with the training that it interrupts."""

    outputs: Outputs
    watch: PlantSupervisor
    override: GainOverride
    monitor: SafetyMonitor


@dataclass(frozen=True)
class Verdict:
    """What came out; one number for each sine, in the order of the settings."""

    rmse: tuple[float, ...]
    """N, of the policy."""
    reference: tuple[float, ...]
    """N, of the fixed gains."""

    @property
    def ratios(self) -> tuple[float, ...]:
        """RMSE over the reference's."""
        return tuple(own / other for own, other in zip(self.rmse, self.reference, strict=True))

    @property
    def score(self) -> float:
        """Mean of the ratios: below 1 the policy beats the fixed gains on the whole."""
        return math.fsum(self.ratios) / len(self.ratios)

    @property
    def beaten(self) -> int:
        """Sines at which it beats them."""
        return sum(ratio < 1.0 for ratio in self.ratios)


def examination(
    settings: ExamSettings, policy: Policy, gains: GainRange, reference_too: bool, around: Surroundings
) -> EvaluationSession:
    """The session that examines `policy`, and if asked the fixed gains that its score is relative to."""
    controllers: list[Controller] = [PolicyController(policy, gains, EXAMINED)]
    if reference_too:
        controllers.append(FixedGains(settings.reference_kp, settings.reference_ki, around.override.base))
    return EvaluationSession(
        settings.evaluation,
        controllers,
        around.outputs,
        watch=around.watch,
        override=around.override,
        monitor=around.monitor,
        retries=RETRIES,
    )


def failure(scores: Sequence[Score]) -> str:
    """Why the policy was stopped; empty if it was not."""
    return next((score.stopped for score in scores if score.controller == EXAMINED and score.stopped), "")


def reference_rmse(settings: ExamSettings, scores: Sequence[Score]) -> list[float]:
    """N, of the fixed gains; those that had to be stopped are worth as much as no tracking at all."""
    nothing = settings.evaluation.amplitude / math.sqrt(2.0)
    return [nothing if score.stopped else score.rmse for score in scores if score.controller != EXAMINED]


def verdict(scores: Sequence[Score], reference: Sequence[float]) -> Verdict:
    """Of an examination that the policy came through."""
    return Verdict(tuple(score.rmse for score in scores if score.controller == EXAMINED), tuple(reference))
