# SPDX-License-Identifier: Apache-2.0
"""The benches that `validate` runs: the emulator as the bench, and the learned simulation.

The emulator's plant is the one that runs behind the serial line, sample for sample; only its clock is left out. Nothing
else in this package imports the emulator.
"""

from __future__ import annotations

from hydro_sim.emulator.truth import TruthPlant
from hydro_sim.emulator.truth_config import profile, truth_from_mapping
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.plant import Plant

CHANGES: dict[str, dict[str, float]] = {
    "emulator": {},
    "spring 10 kN/m": {"spring_stiffness": 1e4},
    "spring 30 kN/m": {"spring_stiffness": 3e4},
    "supply 12 MPa": {"supply_pressure": 12e6},
}
"""The emulated bench, and what is changed of it while filter and box believe the nominal one."""

PLANTS = (*CHANGES, "sim")


def plant_named(name: str, model: str | None = None) -> Plant:
    """One of `PLANTS`; `model`: weights of the learned simulation, the shipped ones by default."""
    if name == "sim":
        return LearnedPlant(model)
    if not CHANGES[name]:
        return TruthPlant(profile("default"))
    return TruthPlant(truth_from_mapping({"profile": "default", "bench": CHANGES[name]}))
