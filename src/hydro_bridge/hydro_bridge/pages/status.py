# SPDX-License-Identifier: Apache-2.0
"""Status of the graph in the pages' words: names of flags and phases, and the learning curve."""

from __future__ import annotations

from math import isfinite

from hydro_core.signals import Flag

PHASES = ("waiting", "training", "evaluating", "paused", "finished")
"""TrainingStatus.phase in words."""


def flag_labels(flags: int) -> list[str]:
    """Return the pages' names of the flags that are set."""
    return [str(flag.name).lower().replace("_", " ") for flag in Flag if flag & flags]


class LearningCurve:
    """Learning curve: results of the finished episodes, at most 1000; beyond that every second one is dropped."""

    KEYS = ("episode", "rmse", "return", "critic_loss", "actor_loss")

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._last = 0
        self._result: tuple[float, ...] = ()

    def add(self, phase: int, episode: int, *result: float) -> None:
        """Add a TrainingStatus; `result`: RMSE [N] and return of the last finished episode, the present losses.

        Changed results are those of a further episode; `episode` is the present one in training, else the last one. A
        smaller episode number starts another run.
        """
        if episode < self._last:
            self._rows.clear()
        before, self._last, self._result = self._result, episode, result[:2]
        if self._result == before or not isfinite(result[1]):
            return
        self._rows.append((episode - (PHASES[phase : phase + 1] == ("training",)), *result))
        if len(self._rows) > 1000:
            del self._rows[::2]

    def content(self) -> dict[str, list[float]]:
        """Return the curve for the page: a list of values for each key of `KEYS`."""
        return {key: [row[column] for row in self._rows] for column, key in enumerate(self.KEYS)}
