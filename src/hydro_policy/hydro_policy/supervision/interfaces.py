# SPDX-License-Identifier: Apache-2.0
"""Interfaces of sessions: to the graph, to the learner process, and of a session itself. No call blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from hydro_bridge.safety.arming import ArmingOutputs
from hydro_bridge.signals import FloatArray, LawCommand

if TYPE_CHECKING:
    from hydro_policy.sac.algorithm import Losses
    from hydro_policy.sac.replay import ReplayBuffer
    from hydro_policy.supervision.override import GainOverride
    from hydro_policy.supervision.plant_supervisor import PlantSupervisor


class Outputs(ArmingOutputs, Protocol):
    """Outputs of a session to the graph. No call blocks."""

    def gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        """Publish gains [1/s], [1/s^2]."""

    def command_law(self, command: LawCommand, step: int) -> None:
        """Publish the force law to run; a plant of which none is asked runs the paper's."""

    def acted(self, step: int, mean: tuple[float, float], reward: float, weights: int) -> None:
        """Report a learning policy's result of `step`, once its gains are sent; see `PolicyStep.msg`.

        Parameters
        ----------
        step
            As given to `gains`.
        mean
            Gains of the mean action [1/s], [1/s^2].
        reward
            Reward of the previous step; NaN if there is none.
        weights
            Digest of the weights that acted.
        """


class ActingLearner(Protocol):
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

    @property
    def losses(self) -> Losses:
        """Losses of the last updates; NaN before the first."""

    def snapshot(self) -> bytes | None:
        """Return the learner's whole state, at most half a second old."""

    def save_policy(self, good: bytes) -> None:
        """Store this state as the last good one."""

    def roll_back(self) -> None:
        """Make the learner return to the last good state."""

    def new_weights(self) -> FloatArray | None:
        """Return the actor's flat parameters if there are newer ones."""

    def restart_if_dead(self) -> str | None:
        """Restart it if it died; returns the message for the user."""

    def save(self, trainer: dict[str, Any], best: bool = False) -> bool:
        """Request a checkpoint."""


class Session(Protocol):
    """Controls a plant: a `TrainingSession` or an `EvaluationSession`."""

    watch: PlantSupervisor
    override: GainOverride

    @property
    def finished(self) -> bool:
        """Whether it needs no more samples."""

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Process a sample; returns True if gains were sent."""

    def on_correction(self, after: float, status: int) -> None:
        """Process the filter's result of a sample: M_c [1/s] under its correction, and the status."""

    def on_tick(self, now: float) -> None:
        """Handle a tick, some twenty times a second."""
