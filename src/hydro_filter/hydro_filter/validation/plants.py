# SPDX-License-Identifier: Apache-2.0
"""Benches of `validate`: the emulator as the bench, and the learned simulation.

The emulator's plant is identical, sample for sample, to the one behind the serial line, except for its clock. Nothing
else in this package imports the emulator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from hydro_bridge.signals import FloatArray
from hydro_sim.emulator.truth.config import TruthConfig, profile, truth_from_mapping
from hydro_sim.emulator.truth.parameters import compile_parameters
from hydro_sim.emulator.truth.plant import TruthPlant
from hydro_sim.files.learned_bench import make_plant
from hydro_sim.model.plant import Plant

CHANGES: dict[str, dict[str, float]] = {
    "emulator": {},
    "spring 10 kN/m": {"spring_stiffness": 1e4},
    "spring 30 kN/m": {"spring_stiffness": 3e4},
    "supply 12 MPa": {"supply_pressure": 12e6},
}
"""Emulated benches and their changes, while filter and box assume the nominal one."""

PLANTS = (*CHANGES, "sim")


def plant_named(name: str, model: str | None = None) -> Plant:
    """One of `PLANTS`; `model`: bench file of the learned simulation, the shipped one by default."""
    if name == "sim":
        return make_plant(model)
    if not CHANGES[name]:
        return TruthPlant(profile("default"))
    return TruthPlant(truth_from_mapping({"profile": "default", "bench": CHANGES[name]}))


def modified_truth(change: Mapping[str, Any]) -> TruthConfig:
    """The emulator's default truth with other `bench` numbers or `effects`."""
    return truth_from_mapping({"profile": "default", **change})


class ChangingPlant:
    """An emulated bench whose parameters change during the run; the piston stays where it is.

    Parameters
    ----------
    truths
        One after the other.
    samples
        At which each but the first takes over.
    """

    def __init__(self, truths: Sequence[TruthConfig], samples: Sequence[int]) -> None:
        self.plant, self._taken = TruthPlant(truths[0]), 0
        self._parameters = [compile_parameters(truth) for truth in truths]
        self._at = dict(zip(samples, self._parameters[1:], strict=True))

    def reset(self, seed: int) -> FloatArray:
        """See `hydro_sim.model.plant.Plant`."""
        self._taken, self.plant.parameters = 0, self._parameters[0]
        return self.plant.reset(seed)

    def step(self, valve_current: float) -> FloatArray:
        """See `hydro_sim.model.plant.Plant`."""
        self._taken += 1
        self.plant.parameters = self._at.get(self._taken, self.plant.parameters)
        return self.plant.step(valve_current)
