# SPDX-License-Identifier: Apache-2.0
"""Interfaces between acting and the learner process. No call blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from hydro_bridge.signals import FloatArray

if TYPE_CHECKING:  # it needs torch, which takes seconds to import, and which evaluate does without
    from hydro_policy.sac.replay import ReplayBuffer


class RollingLearner(Protocol):
    """The learner as rollback needs it."""

    def snapshot(self) -> bytes | None:
        """The learner's whole state, half a second old at most."""

    def keep(self, good: bytes) -> None:
        """Take this state for the last good one."""

    def roll_back(self) -> None:
        """Let the learner go back to the last good state."""


class ActingLearner(RollingLearner, Protocol):
    """The learner as acting needs it: `LearnerSupervisor`, or `InlineLearner` in simulation."""

    replay: ReplayBuffer

    @property
    def ready(self) -> bool:
        """Whether weights have been published."""

    @property
    def updates(self) -> int:
        """Gradient updates so far."""

    @property
    def entropy_coefficient(self) -> float:
        """alpha."""

    def new_weights(self) -> FloatArray | None:
        """The actor's flat parameters if there are newer ones."""

    def restart_if_dead(self) -> str | None:
        """Restart it if it died; returns what to tell the user."""

    def save(self, trainer: dict[str, Any], best: bool = False) -> bool:
        """Ask for a checkpoint."""
