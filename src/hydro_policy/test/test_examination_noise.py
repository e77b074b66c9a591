# SPDX-License-Identifier: Apache-2.0
"""Which policy is the best by examinations that are noisy: better by more than their scatter, or the one that came."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_policy.evaluation.policy_examination import EXAMINED, significantly_better
from hydro_policy.runs.run import RunRecord, TrainingSettings
from hydro_policy.sac.algorithm import Losses, Sac
from hydro_policy.sac.snapshot import actor_parameters, dump
from hydro_policy.sessions.run_state import Progress, RunState
from hydro_policy.task.cases import Score
from hydro_policy.task.mdp import ACTIONS, OBSERVATIONS

CASES = ("0.5 Hz", "1 Hz", "1.5 Hz", "2 Hz")
FIXED = np.array([5.0, 12.0, 20.0, 40.0])


def scores(runs: np.ndarray, controller: str = EXAMINED) -> list[Score]:
    """Of runs, N, shape (repeats, cases)."""
    return [
        Score(controller=controller, case=case, frequency=1.0, repeat=repeat, rmse=float(value))
        for repeat, row in enumerate(runs)
        for case, value in zip(CASES, row, strict=True)
    ]


class Learner:
    """Gives one state after another."""

    entropy_coefficient, updates, losses = 0.0, 0, Losses()

    def __init__(self) -> None:
        self.states: list[bytes] = []
        self.learn()

    def learn(self) -> None:
        """Another state."""
        settings = replace(TrainingSettings().sac, seed=len(self.states))
        self.states.append(dump(Sac(OBSERVATIONS, ACTIONS, settings)))

    def snapshot(self) -> bytes:
        return self.states[-1]

    def save_policy(self, good: bytes) -> None:
        pass


@pytest.mark.parametrize(
    ("score", "errors", "best_error", "better"),
    [
        (0.9, [0.0, 0.0], 0.0, True),
        (0.9, [0.05, 0.05], 0.05, False),
        (0.9, [0.03, 0.03], 0.03, True),
        (0.9, [0.0, 0.07], 0.0, False),
        (0.9, [0.0] * 40 + [0.05], 0.0, False),
        (0.9, [0.1, *[0.01] * 8], 0.1, False),
        (0.9, [0.03] * 9, 0.03, False),
    ],
)
def test_better_is_better_by_more_than_the_noise(
    score: float, errors: list[float], best_error: float, better: bool
) -> None:
    """The best score's own noise counts, and so does how often a run has compared."""
    assert significantly_better(score, 1.0, errors, best_error) is better


def test_a_policy_that_came_is_handed_back_unless_another_is_surely_better() -> None:
    learner, progress = Learner(), Progress(reference_rmse=FIXED.tolist())
    state = RunState(TrainingSettings(), learner, progress, None, RunRecord())  # type: ignore[arg-type]
    came = actor_parameters(learner.states[0])

    def examined(share: float, scatter: float) -> bool:
        state.propose()
        return state.add_exam(scores(share * FIXED * np.array([[1.0 - scatter], [1.0 + scatter]])))

    assert examined(0.5, 0.04)
    learner.learn()
    assert not examined(0.48, 0.04), "better by less than the scatter"
    np.testing.assert_array_equal(state.best, came)
    assert progress.best_score == pytest.approx(0.5)
    assert examined(0.3, 0.04)
    np.testing.assert_array_equal(state.best, actor_parameters(learner.states[1]))
    assert np.any(state.best != came)
