# SPDX-License-Identifier: Apache-2.0
"""Policy evaluation between training episodes: force RMSE on a few sines, relative to fixed gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

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

SURE = 2.0
"""Standard errors that a score must be better by: a single comparison passes by chance about once in forty times."""

EXAMINED = "policy"
"""Name of the policy in an examination's scores."""


@dataclass(frozen=True)
class SessionContext:
    """Context that an examination shares with the training session that it interrupts."""

    outputs: Outputs
    watch: PlantSupervisor
    override: GainOverride
    monitor: SafetyMonitor


@dataclass(frozen=True)
class Verdict:
    """Result of an examination; one value per sine, in the order of the settings."""

    rmse: tuple[float, ...]
    """N, of the policy, mean over the repeats."""
    reference: tuple[float, ...]
    """N, of the fixed gains."""
    errors: tuple[float, ...] = ()
    """N, standard errors of `rmse` by the scatter of the repeats; empty: there were none."""

    @property
    def ratios(self) -> tuple[float, ...]:
        """RMSE over the reference's."""
        return tuple(own / other for own, other in zip(self.rmse, self.reference, strict=True))

    @property
    def score(self) -> float:
        """Mean of the ratios: below 1 the policy beats the fixed gains on the whole."""
        return math.fsum(self.ratios) / len(self.ratios)

    @property
    def score_error(self) -> float:
        """Standard error of the score; 0 without repeats. That of the reference is common to all scores of a run."""
        return math.hypot(*(own / other for own, other in zip(self.errors, self.reference, strict=False))) / len(
            self.rmse
        )

    @property
    def beaten(self) -> int:
        """Sines at which it beats them."""
        return sum(ratio < 1.0 for ratio in self.ratios)


def significantly_better(score: float, best: float, errors: Sequence[float]) -> bool:
    """Whether a score is below the best one by more than the noise of the two.

    Parameters
    ----------
    errors
        Standard errors of all scores of the run: two runs of a sine alone say too little of their scatter. Of a score
        of single runs it is 0: nothing is known.
    """
    known = [error for error in errors if error > 0.0]
    noise = math.hypot(*known) / math.sqrt(len(known)) if known else 0.0
    return score < best - SURE * math.sqrt(2.0) * noise


def examination(
    settings: ExamSettings, policy: Policy, gains: GainRange, reference_too: bool, around: SessionContext
) -> EvaluationSession:
    """Create the session that examines `policy` and, if asked, the fixed gains that its score is relative to."""
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


def stop_reason(scores: Sequence[Score]) -> str:
    """Why the policy was stopped; empty if it was not."""
    return next((score.stopped for score in scores if score.controller == EXAMINED and score.stopped), "")


def reference_rmse(settings: ExamSettings, scores: Sequence[Score]) -> list[float]:
    """Force RMSE [N] of the fixed gains; runs that had to be stopped count as no tracking at all."""
    nothing = settings.evaluation.amplitude / math.sqrt(2.0)
    return [
        float(np.mean([nothing if score.stopped else score.rmse for score in runs]))
        for runs in _by_case([score for score in scores if score.controller != EXAMINED])
    ]


def verdict(scores: Sequence[Score], reference: Sequence[float]) -> Verdict:
    """Verdict of an examination that the policy completed."""
    runs = [[score.rmse for score in one] for one in _by_case([s for s in scores if s.controller == EXAMINED])]
    errors = tuple(float(np.std(one, ddof=1)) / math.sqrt(len(one)) for one in runs if len(one) > 1)
    return Verdict(tuple(float(np.mean(one)) for one in runs), tuple(reference), errors)


def _by_case(scores: Sequence[Score]) -> list[list[Score]]:
    """The runs of each sine, sines in the order in which they first came."""
    names = dict.fromkeys(score.case for score in scores)
    return [[score for score in scores if score.case == name] for name in names]
