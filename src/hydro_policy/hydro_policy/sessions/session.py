# SPDX-License-Identifier: Apache-2.0
"""Interface of a session, which controls a plant step by step."""

from __future__ import annotations

from typing import Protocol

from hydro_bridge.signals import FloatArray
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor


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
