# SPDX-License-Identifier: Apache-2.0
"""Wrong values of the bench file, applied in the order of the file and kept within the bench's ranges."""

from __future__ import annotations

from typing import Any

from hydro_sim.model.effects.base import Effect, parameter


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


class SpringStiffness(Effect):
    """Wrong k_s in the bench file."""

    id = "spring_stiffness"
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def correct(self, n: Any) -> None:
        n.spring_stiffness = n.spring_stiffness * self.ratio


class SpringRest(Effect):
    """The true x_rest."""

    id = "spring_rest"
    position = parameter("m", -5.0, 5.0, scale=1e-3)

    def correct(self, n: Any) -> None:
        n.spring_rest_position = self.position


class SupplyPressure(Effect):
    """Wrong p_s in the bench file."""

    id = "supply_pressure"
    ratio = parameter("-", 0.01, 100.0, scale=0.05, neutral=1.0)

    def correct(self, n: Any) -> None:
        n.supply_pressure = n.supply_pressure * self.ratio


class TankPressure(Effect):
    """The true p_t."""

    id = "tank_pressure"
    pressure = parameter("Pa", 0.0, 1e7, scale=1e5)

    def correct(self, n: Any) -> None:
        n.tank_pressure = self.pressure


class PistonArea(Effect):
    """Wrong A_p in the bench file."""

    id = "piston_area"
    ratio = parameter("-", 0.01, 100.0, scale=0.02, neutral=1.0)

    def correct(self, n: Any) -> None:
        n.piston_area = n.piston_area * self.ratio


class AreaRatio(Effect):
    """Wrong alpha in the bench file."""

    id = "area_ratio"
    ratio = parameter("-", 0.01, 100.0, scale=0.02, neutral=1.0)

    def correct(self, n: Any) -> None:
        n.area_ratio = n.area_ratio * self.ratio


class DeadVolume(Effect):
    """Wrong V_dead of a chamber in the bench file."""

    id = "dead_volume"
    options = {"chamber": ("a", "b")}
    ratio = parameter("-", 0.01, 100.0, scale=0.1, neutral=1.0)

    def correct(self, n: Any) -> None:
        name = f"dead_volume_{self.chamber}"
        setattr(n, name, getattr(n, name) * self.ratio)


EFFECTS = (
    FrictionViscous, MovingMass, SpringStiffness, SpringRest, SupplyPressure, TankPressure, PistonArea, AreaRatio,
    DeadVolume,
)  # fmt: skip
