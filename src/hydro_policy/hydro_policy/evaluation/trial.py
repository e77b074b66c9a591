# SPDX-License-Identifier: Apache-2.0
"""Trials, and the plans that say which is next: a comparison of controllers over references, repeat by repeat.

A trial is one controller over one reference: seconds to settle, then seconds that count. Its result is a
`task.cases.Score`. `runner.TrialRunner` makes them on a plant; `gain_search` and `collect` have plans of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from hydro_policy.evaluation.controllers import Controller
from hydro_policy.task.cases import Case, EvaluationSettings, Score


@dataclass(frozen=True, kw_only=True)
class Trial:
    """One controller over one reference."""

    controller: Controller
    case: Case
    repeat: int = 0
    settle: float
    """s that do not count."""
    measure: float
    """s that count."""
    judged: bool = True
    """Whether it is scored, and made again where the machine was held up; otherwise only its end is told."""

    def stopped(self, why: str) -> Score:
        """Return the score of this trial, stopped."""
        return Score(
            controller=self.controller.name, case=self.case.name, frequency=self.case.signal.frequency,
            repeat=self.repeat, stopped=why,
        )  # fmt: skip


class Plan(Protocol):
    """Trials in the order in which they are made."""

    @property
    def trial(self) -> Trial | None:
        """The trial that is due; None: no more."""

    def add(self, score: Score) -> None:
        """Take the score of the trial that was due."""


class Comparison:
    """All controllers over all cases. Controllers follow each other closely, so that drift affects all alike.

    Those of the compensated law are last, since the plant is disarmed for another law.

    Parameters
    ----------
    settings
        References and lengths of the trials.
    controllers
        At least one.
    lead
        s that each controller's first trial settles longer; then each controller makes all its trials before the next.
    """

    def __init__(self, settings: EvaluationSettings, controllers: Sequence[Controller], lead: float = 0.0) -> None:
        if not controllers:
            raise ValueError("an evaluation needs a controller")
        self.settings, self.controllers, self.done = settings, controllers, 0
        order = [(r, c, k) for r in range(settings.repeats) for c in settings.cases for k in controllers]
        if lead:
            order.sort(key=lambda run: controllers.index(run[2]))
        order.sort(key=lambda run: run[2].law.law)
        self.trials: list[Trial] = []
        for repeat, case, controller in order:
            first = not self.trials or self.trials[-1].controller is not controller
            self.trials.append(
                Trial(controller=controller, case=case, repeat=repeat, settle=settings.settle + lead * first,
                      measure=settings.measured(case))
            )  # fmt: skip

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def trial(self) -> Trial | None:
        """See `Plan`."""
        return self.trials[self.done] if self.done < len(self.trials) else None

    def add(self, score: Score) -> None:
        """See `Plan`."""
        self.done += 1

    @property
    def seconds(self) -> float:
        """Bench time of all trials, s."""
        return sum(trial.settle + trial.measure for trial in self.trials)
