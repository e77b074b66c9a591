# SPDX-License-Identifier: Apache-2.0
"""Emulated benches that are not the believed one, from the beginning or during a run; for tests and benchmarks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydro_core.signals import FloatArray
from hydro_sim.emulator.truth.config import TruthConfig, truth_from_mapping
from hydro_sim.emulator.truth.parameters import compile_parameters
from hydro_sim.emulator.truth.plant import TruthPlant


def modified_truth(change: Mapping[str, Any]) -> TruthConfig:
    """The emulator's default truth with other `bench` numbers or `effects`."""
    return truth_from_mapping({"profile": "default", **change})


class ChangingPlant:
    """An emulated bench whose parameters change during the run; the piston stays where it is.

    `truths`: one after the other. `samples`: at which each but the first takes over.
    """

    def __init__(self, truths: Sequence[TruthConfig], samples: Sequence[int]) -> None:
        self.plant, self._taken = TruthPlant(truths[0]), 0
        self._at = {at: compile_parameters(truth) for at, truth in zip([0, *samples], truths, strict=True)}

    def reset(self, seed: int) -> FloatArray:
        self._taken, self.plant.parameters = 0, self._at[0]
        return self.plant.reset(seed)

    def step(self, valve_current: float) -> FloatArray:
        self._taken += 1
        self.plant.parameters = self._at.get(self._taken, self.plant.parameters)
        return self.plant.step(valve_current)
