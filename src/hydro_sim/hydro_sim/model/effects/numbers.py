# SPDX-License-Identifier: Apache-2.0
"""Wrong values of the bench file, applied in the order of the file and kept within the bench's ranges."""

from __future__ import annotations

from typing import Any

from hydro_sim.model.effects.base import Effect, parameter


def wrong(number: str, scale: float) -> type[Effect]:
    """The effect that a number of the bench file is wrong, under the number's name: its true value over the file's."""

    def correct(self: Any, n: Any) -> None:
        setattr(n, number, getattr(n, number) * self.ratio)

    ratio = parameter("-", 0.01, 100.0, scale=scale, neutral=1.0)
    return type(number, (Effect,), {"id": number, "ratio": ratio, "correct": correct})


class FrictionViscous(Effect):
    """A change of b."""

    id = "friction_viscous"
    coefficient = parameter("N s/m", -1e6, 1e6, scale=30.0)

    def correct(self, n: Any) -> None:
        n.viscous_friction = n.viscous_friction + self.coefficient


class MovingMass(Effect):
    """A change of m."""

    id = "moving_mass"
    mass = parameter("kg", -1e4, 1e4, scale=0.3)

    def correct(self, n: Any) -> None:
        n.moving_mass = n.moving_mass + self.mass


class SpringRest(Effect):
    """The true x_rest."""

    id = "spring_rest"
    position = parameter("m", -5.0, 5.0, scale=1e-3)

    def correct(self, n: Any) -> None:
        n.spring_rest_position = self.position


class TankPressure(Effect):
    """The true p_t."""

    id = "tank_pressure"
    pressure = parameter("Pa", 0.0, 1e7, scale=1e5)

    def correct(self, n: Any) -> None:
        n.tank_pressure = self.pressure


class DeadVolume(Effect):
    """Wrong V_dead of a chamber in the bench file."""

    id = "dead_volume"
    options = {"chamber": ("a", "b")}
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def correct(self, n: Any) -> None:
        name = f"dead_volume_{self.chamber}"
        setattr(n, name, getattr(n, name) * self.ratio)


EFFECTS = (
    FrictionViscous, MovingMass, wrong("spring_stiffness", 0.1), SpringRest, wrong("supply_pressure", 0.05),
    TankPressure, wrong("piston_area", 0.02), wrong("area_ratio", 0.02), DeadVolume,
)  # fmt: skip
