# SPDX-License-Identifier: Apache-2.0
"""Interfaces of sessions: to the graph, and of a session itself. No call blocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from hydro_bridge.safety.arming import ArmingOutputs
from hydro_bridge.signals import FloatArray, LawCommand

if TYPE_CHECKING:
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
