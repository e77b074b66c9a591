# SPDX-License-Identifier: Apache-2.0
"""What a session is, and what it may do to the graph: the seam between the mathematics and ROS."""

from __future__ import annotations

from typing import Protocol

from hydro_bridge.signals import FloatArray, ReferenceSignal


class Outputs(Protocol):
    """What a session may do to the graph. Nothing waits."""

    def gains(self, delta_kp: float, delta_ki: float, step: int) -> None:
        """Publish gains [1/s], [1/s^2]."""

    def reference(self, signal: ReferenceSignal) -> None:
        """Publish the force to track."""

    def arm(self, arm: bool) -> None:
        """Ask the plant to arm or disarm."""

    def say(self, sentence: str, warning: bool = False) -> None:
        """Tell the user."""


class Session(Protocol):
    """What drives a plant: a `TrainingSession` or an `EvaluationSession`."""

    @property
    def finished(self) -> bool:
        """Whether it wants no more samples."""

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample; True if it made a policy step."""

    def on_tick(self, now: float) -> None:
        """Take a moment, some twenty times a second."""
