# SPDX-License-Identifier: Apache-2.0
"""Interfaces of the acting process to the learner process. No call blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from hydro_bridge.signals import FloatArray

if TYPE_CHECKING:  # it needs torch, which takes seconds to import, and which evaluate does without
    from hydro_policy.sac.replay import ReplayBuffer


class RollingLearner(Protocol):
    """Interface of the learner for rollback."""

    def snapshot(self) -> bytes | None:
        """Return the learner's whole state, at most half a second old."""

    def keep(self, good: bytes) -> None:
        """Store this state as the last good one."""

    def roll_back(self) -> None:
        """Make the learner return to the last good state."""


class ActingLearner(RollingLearner, Protocol):
    """Interface of the learner for acting: `LearnerSupervisor`, or `InlineLearner` in simulation."""

    replay: ReplayBuffer

    @property
    def ready(self) -> bool:
        """Whether weights have been published."""

    @property
    def updates(self) -> int:
        """Gradient updates so far."""

    @property
    def entropy_coefficient(self) -> float:
        """Entropy coefficient alpha."""

    def new_weights(self) -> FloatArray | None:
        """Return the actor's flat parameters if there are newer ones."""

    def restart_if_dead(self) -> str | None:
        """Restart it if it died; returns the message for the user."""

    def save(self, trainer: dict[str, Any], best: bool = False) -> bool:
        """Request a checkpoint."""
