# SPDX-License-Identifier: Apache-2.0
"""Outputs of a session: the interface between the algorithms and ROS."""

from __future__ import annotations

from typing import Protocol

from hydro_bridge.signals import LawCommand, ReferenceSignal


class Outputs(Protocol):
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

    def reference(self, signal: ReferenceSignal) -> None:
        """Publish the force to track."""

    def arm(self, arm: bool) -> None:
        """Request the plant to arm or disarm."""

    def say(self, sentence: str, warning: bool = False) -> None:
        """Report a sentence to the user."""
