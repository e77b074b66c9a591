# SPDX-License-Identifier: Apache-2.0
"""Status of the graph for the page: encoding of messages, labels of flags, learning curve.

The learning curve is bounded: at most `CURVE_POINTS_MAX` episodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from math import isfinite, nan
from typing import Any

import msgspec

from hydro_core.signals import Flag

CURVE_POINTS_MAX = 1000
"""Maximum number of points of the learning curve; beyond it every second one is dropped."""
PHASES = ("waiting", "training", "evaluating", "paused", "finished")
"""TrainingStatus.phase in words."""
PLANT_TIMEOUT = 0.5
"""s without a sample after which the plant counts as lost."""


def encode_message(kind: str, content: Mapping[str, Any]) -> str:
    """Encode a message to the page; non-finite values become null."""
    return msgspec.json.encode({"kind": kind, **content}).decode()


def flag_labels(flags: int) -> list[str]:
    """Return the page's names of the flags that are set."""
    return [str(flag.name).lower().replace("_", " ") for flag in Flag if flag & flags]


class LearningCurve:
    """Learning curve: results of the finished episodes."""

    KEYS = ("episode", "rmse", "return", "critic_loss", "actor_loss")

    def __init__(self) -> None:
        self._rows: list[tuple[float, ...]] = []
        self._last = 0
        self._result = (nan, nan)

    def add(
        self, phase: int, episode: int, rmse: float, episode_return: float, critic_loss: float, actor_loss: float
    ) -> None:
        """Add a TrainingStatus; `episode` is the present one, in other phases than training the last one.

        RMSE [N] and return are those of the last finished episode: changed results are those of a further episode. A
        smaller episode number starts another run. The losses are the present ones.
        """
        if episode < self._last:
            self._rows.clear()
        result, self._last = (rmse, episode_return), episode
        if result == self._result or not isfinite(episode_return):
            return
        self._result = result
        under_way = PHASES[phase : phase + 1] == ("training",)
        self._rows.append((episode - 1 if under_way else episode, rmse, episode_return, critic_loss, actor_loss))
        if len(self._rows) > CURVE_POINTS_MAX:
            del self._rows[::2]

    def content(self) -> dict[str, Any]:
        """Return the curve for the page: a list of values for each key of `KEYS`."""
        return {key: [row[column] for row in self._rows] for column, key in enumerate(self.KEYS)}
