# SPDX-License-Identifier: Apache-2.0
"""Benches of `validate`: the emulator as the bench, and the learned simulation.

The emulator's plant is identical, sample for sample, to the one behind the serial line, except for its clock. Nothing
else in this package imports the emulator.
"""

from __future__ import annotations

from hydro_sim.emulator.truth.config import profile, truth_from_mapping
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
