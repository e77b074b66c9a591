# SPDX-License-Identifier: Apache-2.0
"""Trials, and plans (sequences of trials) such as a comparison of controllers over references.

A trial is a run of one controller on one reference: a settling time, then a measured time. Its result is a
`task.cases.Score`. `runner.TrialRunner` runs the trials on a plant; `gain_search`, `training_plan` and `nodes.collect`
have further plans.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass

from hydro_policy.evaluation.controllers import Controller
from hydro_policy.task.cases import Case, EvaluationSettings, Score


@dataclass(frozen=True, kw_only=True)
class Trial:
    """Run of one controller on one reference, with a settling and a measured time."""

    controller: Controller
    case: Case
    repeat: int = 0
    settle: float  # settling time, not measured, s
    measure: float  # measured time, s
    is_scored: bool = True
    """Whether it is scored, and repeated if disturbed; otherwise only its end is reported to the plan."""

    @property
    def name(self) -> str:
        """Name for messages: `fixed (90, 15) at 2 Hz`."""
        return f"{self.controller.name} at {self.case.name}"

    def empty_score(self, why: str = "") -> Score:
        """Return a score of this trial without figures; `why`: reason of a stop, empty if there was none."""
        return Score(
            controller=self.controller.name, case=self.case.name, frequency=self.case.signal.frequency,
            repeat=self.repeat, stopped=why,
        )  # fmt: skip


class Plan:
    """Sequence of trials, with hooks that `runner.TrialRunner` calls between them."""

    training: bool = False  # whether trials follow each other without a gap, and their samples are not stored
    total: float = 0.0  # number of trials, or their duration [s], for a progress bar; 0: unknown
    done: float = 0.0  # completed part of `total`

    def set_trials(self, trials: Generator[Trial, Score, None]) -> None:
        """Set the generator of the trials; it yields each trial, and is sent its score."""
        self._trials, self._trial = trials, next(trials, None)

    @property
    def trial(self) -> Trial | None:
        """Present trial, running or next; None: the plan is complete."""
        return self._trial

    def add(self, score: Score) -> str:
        """Add the present trial's score and advance; returns a message about a stop for the user, or an empty one."""
        try:
            self._trial = self._trials.send(score)
        except StopIteration:
            self._trial = None
        return ""

    def prepare_trial(self, trial: Trial) -> None:
        """Prepare the start, or restart, of the present trial."""
        return

    def pause(self) -> None:
        """Handle the interruption of a trial: the plant was disarmed, or lost."""
        return

    def prepare_step(self, *, synchronous: bool) -> None:
        """Prepare a policy step of a training; `synchronous`: the plant on its own clock waits for the return."""
        return

    def poll(self) -> str:
        """Poll background work, some twenty times a second; returns a warning, or an empty text."""
        return ""


class Comparison(Plan):
    """Comparison of all controllers on all cases, interleaved, so that drift of the bench affects all alike.

    Controllers under the compensated law are last, since a change of the law requires disarming.

    `settings`: references and lengths of the trials. `controllers`: at least one. `extra_settling_time`: added to the
    settling time of each controller's first trial [s]; if not 0, controllers are not interleaved.
    """

    def __init__(
        self, settings: EvaluationSettings, controllers: Sequence[Controller], extra_settling_time: float = 0.0
    ) -> None:
        self.settings, self.controllers = settings, controllers
        order = [(r, c, k) for r in range(settings.repeats) for c in settings.cases for k in controllers]
        if extra_settling_time:
            order.sort(key=lambda run: controllers.index(run[2]))
        order.sort(key=lambda run: run[2].law.law)
        self.trials: list[Trial] = []
        self.total = len(order)
        for repeat, case, controller in order:
            first = not self.trials or self.trials[-1].controller is not controller
            settle = settings.settle + extra_settling_time * first
            self.trials.append(
                Trial(controller=controller, case=case, repeat=repeat, settle=settle,
                      measure=settings.measured_time(case))
            )  # fmt: skip

        self.set_trials(self._in_turn())

    def _in_turn(self) -> Generator[Trial, Score, None]:
        for trial in self.trials:
            yield trial
            self.done += 1

    def __len__(self) -> int:
        return len(self.trials)

    @property
    def seconds(self) -> float:
        """Duration of all trials on the bench, s."""
        return sum(trial.settle + trial.measure for trial in self.trials)
