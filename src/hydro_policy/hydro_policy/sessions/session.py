# SPDX-License-Identifier: Apache-2.0
"""The interface of a session, which drives a plant step by step."""

from __future__ import annotations

from typing import Protocol

from hydro_bridge.signals import FloatArray
from hydro_policy.supervision.override import GainOverride
from hydro_policy.supervision.plant_supervisor import PlantSupervisor


class Session(Protocol):
    """Drives a plant: a `TrainingSession` or an `EvaluationSession`."""

    watch: PlantSupervisor
    override: GainOverride

    @property
    def finished(self) -> bool:
        """Whether it wants no more samples."""

    def on_sample(self, sequence: int, sample: FloatArray, flags: int, now: float) -> bool:
        """Take a sample; True if gains went out."""

    def on_correction(self, after: float, status: int) -> None:
        """Take what the filter says of a sample: M_c [1/s] under its correction, and the status."""

    def on_tick(self, now: float) -> None:
        """Take a moment, some twenty times a second."""
