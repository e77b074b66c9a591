# SPDX-License-Identifier: Apache-2.0
"""Policy evaluation between training episodes: force RMSE on a few sines, relative to fixed gains."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import NormalDist

import numpy as np

from hydro_policy.task.cases import ExamSettings, Score

CHANCE = 0.025
"""Probability that a score passes for better by chance, over the comparisons of the run so far (Bonferroni)."""

LEAD = 16.0
"""s that a policy, or the fixed gains, act before the first sine of an examination that follows no episode.

What arming or other gains leave in the box's integral fades with K_p / K_i, which is 6 s for (90, 15) and up to 18 s.
"""

EXAMINED = "policy"
"""Name of the policy in an examination's scores."""


@dataclass(frozen=True)
class Verdict:
    """Result of an examination that the policy completed."""

    rmse: list[float]
    """Force RMSE at each sine [N], in the order of the settings, mean over the repeats."""
    score: float
    """Mean of its ratios to that of the fixed gains: below 1 the policy beats them on average."""
    error: float
    """Standard error of the score by the scatter of repeats, 0 without; that of the reference is common to a run."""
    beaten: int
    """Number of sines at which the policy beats the fixed gains."""


def significantly_better(score: float, best: float, errors: Sequence[float], best_error: float = 0.0) -> bool:
    """Return whether a score is below the best one by more than the noise of both.

    `errors`: standard errors of all scores of the run, this one's last. Two runs of a sine alone give a poor estimate
    of their scatter: the root of the mean square of all of them counts where a score's own is smaller. For a score of
    single runs it is 0: unknown. `best_error`: that of the best score.
    """
    known = [error for error in errors if error > 0.0]
    pooled = math.hypot(*known) / math.sqrt(len(known)) if known else 0.0
    noise = math.hypot(max(errors[-1], pooled), max(best_error, pooled))
    return score < best - NormalDist().inv_cdf(1.0 - CHANCE / max(len(errors) - 1, 1)) * noise


def stop_reason(scores: Sequence[Score]) -> str:
    """Return why the policy was stopped; empty if it was not."""
    return next((score.stopped for score in scores if score.controller == EXAMINED and score.stopped), "")


def reference_rmse(settings: ExamSettings, scores: Sequence[Score]) -> list[float]:
    """Return the force RMSE [N] of the fixed gains; runs that had to be stopped count as no tracking at all."""
    nothing = settings.evaluation.amplitude / math.sqrt(2.0)
    return [
        float(np.mean([nothing if score.stopped else score.rmse for score in runs]))
        for runs in _by_case([score for score in scores if score.controller != EXAMINED])
    ]


def verdict(scores: Sequence[Score], reference: Sequence[float]) -> Verdict:
    """Return the verdict of an examination; `reference`: force RMSE of the fixed gains at each sine [N]."""
    runs = [[score.rmse for score in one] for one in _by_case([s for s in scores if s.controller == EXAMINED])]
    rmse = [float(np.mean(one)) for one in runs]
    ratios = [own / other for own, other in zip(rmse, reference, strict=True)]
    repeated = [(one, other) for one, other in zip(runs, reference, strict=True) if len(one) > 1]
    errors = [float(np.std(one, ddof=1)) / math.sqrt(len(one)) / other for one, other in repeated]
    score, error = math.fsum(ratios) / len(ratios), math.hypot(*errors) / len(ratios)
    return Verdict(rmse, score, error, sum(ratio < 1.0 for ratio in ratios))


def _by_case(scores: Sequence[Score]) -> list[list[Score]]:
    """Return the runs of each sine, sines in order of first occurrence."""
    names = dict.fromkeys(score.case for score in scores)
    return [[score for score in scores if score.case == name] for name in names]
