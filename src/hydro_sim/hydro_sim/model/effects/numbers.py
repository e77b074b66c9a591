# SPDX-License-Identifier: Apache-2.0
"""Wrong values of the bench file, applied in the order of the file and kept within the bench's ranges."""

from __future__ import annotations

from collections.abc import Callable
from operator import add, mul
from typing import Any

from hydro_sim.model.effects.base import Effect, parameter
from hydro_sim.model.equations import Symbol


def correction_effect(
    identifier: str, number: str, name: str, quantity: Any, corrected: Callable[[Symbol, Symbol], Symbol]
) -> type[Effect]:
    """Return the effect class that replaces a number of the bench file by `corrected(file value, parameter)`."""

    def correct(self: Any, n: Any) -> None:
        setattr(n, number, corrected(getattr(n, number), getattr(self, name)))

    return type(identifier, (Effect,), {"id": identifier, name: quantity, "correct": correct})


def ratio_effect(number: str, scale: float) -> type[Effect]:
    """Return the effect class of a wrong number, whose parameter is the ratio of true value to the file's."""
    return correction_effect(number, number, "ratio", parameter("-", 0.01, 100.0, scale=scale, neutral=1.0), mul)


def _replaced(filed: Symbol, true: Symbol) -> Symbol:
    return true


class DeadVolume(Effect):
    """Wrong V_dead of a chamber in the bench file."""

    id = "dead_volume"
    options = {"chamber": ("a", "b")}
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def correct(self, n: Any) -> None:
        name = f"dead_volume_{self.chamber}"
        setattr(n, name, getattr(n, name) * self.ratio)


EFFECTS = (
    correction_effect(
        "friction_viscous", "viscous_friction", "coefficient", parameter("N s/m", -1e9, 1e9, scale=30.0), add
    ),
    correction_effect("moving_mass", "moving_mass", "mass", parameter("kg", -1e7, 1e7, scale=0.3), add),
    ratio_effect("spring_stiffness", 0.1),
    correction_effect(
        "spring_rest", "spring_rest_position", "position", parameter("m", -5.0, 5.0, scale=1e-3), _replaced
    ),
    ratio_effect("supply_pressure", 0.05),
    correction_effect("tank_pressure", "tank_pressure", "pressure", parameter("Pa", 0.0, 1e7, scale=1e5), _replaced),
    ratio_effect("piston_area", 0.02),
    ratio_effect("area_ratio", 0.02),
    DeadVolume,
)
