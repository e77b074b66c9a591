# SPDX-License-Identifier: Apache-2.0
"""Effects on the piston's motion: friction, cushions, stops, load.

How dry friction holds is part of the model (`model.rates`); its effects give the level at which it yields. With
bristles nothing holds: dF/dx = sigma (1 - F sign(x_p')/level), solved exactly along a step. Sources: Armstrong-Helouvry
et al. 1994, eq. 5; Dahl 1968.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from hydro_sim.model.effects.base import Effect, hidden, parameter
from hydro_sim.model.equations import Symbol, choose, clip

QUADRATIC_DEPTH = 5e-3
"""Depth [m] at which a quadratic cushion has the force of the linear one."""

LEVEL_MIN = 1e-6
"""Lower bound [N] of a bristle's level."""


class FrictionCoulomb(Effect):
    """Constant force against the motion."""

    id = "friction_coulomb"
    force = parameter("N", 0.0, 1e8, scale=10.0)

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + self.force


class FrictionCoulombDirectional(Effect):
    """One force while extending, another while retracting."""

    id = "friction_coulomb"
    options = {"form": ("directional",)}
    force_positive = parameter("N", 0.0, 1e8, scale=10.0)
    force_negative = parameter("N", 0.0, 1e8, scale=10.0)

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + choose(velocity > 0.0, self.force_positive, self.force_negative)


class FrictionStribeck(Effect):
    """Additional dry friction near standstill."""

    id = "friction_stribeck"
    breakaway_force = parameter("N", 0.0, 1e8, scale=5.0)
    velocity = parameter("m/s", 1e-4, 10.0, scale=0.01, neutral=0.01)

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        ratio = velocity / self.velocity
        return level + self.breakaway_force * np.exp(-ratio * ratio)


class FrictionViscousDirectional(Effect):
    """A change of b while extending, another while retracting."""

    id = "friction_viscous"
    options = {"form": ("directional",)}
    coefficient_positive = parameter("N s/m", -1e9, 1e9, scale=30.0)
    coefficient_negative = parameter("N s/m", -1e9, 1e9, scale=30.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return choose(velocity > 0.0, self.coefficient_positive, self.coefficient_negative) * velocity


class FrictionPresliding(Effect):
    """Bristles that bend before they slide, at the level of the other dry friction."""

    id = "friction_presliding"
    single = True
    stiffness = parameter("N/m", 1.0, 1e11, scale=2e5, neutral=1e7)
    bent = hidden("N", scale=5.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        level, moved = self.at.dry_level(velocity), position - self.at.began
        goal = np.sign(moved) * level
        return goal + (self.bent - goal) * np.exp(-self.stiffness * np.abs(moved) / np.fmax(level, LEVEL_MIN))

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["bent"] = self.opposing_force(position, velocity)


class ForceOffset(Effect):
    """A constant force on the piston."""

    id = "force_offset"
    force = parameter("N", -1e8, 1e8, scale=5.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return -self.force


class EndCushion(Effect):
    """A spring, or one that hardens, before either end of the stroke."""

    id = "end_cushion"
    options = {"form": ("end", "start", "end-quadratic", "start-quadratic")}
    stiffness = parameter("N/m", 0.0, 1e11, scale=2e4)
    position = parameter("m", -5.0, 5.0, scale=0.01, neutral=0.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        beyond = position - self.position
        depth = np.fmax(beyond, 0.0) if self.form.startswith("end") else np.fmin(beyond, 0.0)
        return self.stiffness * depth * (np.abs(depth) / QUADRATIC_DEPTH if "quadratic" in self.form else 1.0)


class SpringHardening(Effect):
    """A cubic part of the load's spring."""

    id = "spring_hardening"
    coefficient = parameter("N/m3", -1e11, 1e11, scale=1e7)

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        deflection = position - self.at.numbers.spring_rest_position
        return force + self.coefficient * deflection * deflection * deflection


class Backlash(Effect):
    """A gap around the spring's rest, in which it carries nothing."""

    id = "backlash"
    width = parameter("m", 0.0, 0.1, scale=1e-3)

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        n, half = self.at.numbers, 0.5 * self.width
        return force - n.spring_stiffness * clip(position - n.spring_rest_position, -half, half)


class BacklashPlay(Backlash):
    """Play in the linkage: the spring is dragged behind the piston, and lags by half the width at each reversal."""

    options = {"form": ("play",)}
    single = True
    dragged = hidden("m", scale=1e-2)

    def begin(self, signals: Mapping[str, Symbol]) -> dict[str, Symbol]:
        return {"dragged": signals["piston_position"]}

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force - self.at.numbers.spring_stiffness * (position - self._end(position))

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["dragged"] = self._end(position)

    def _end(self, position: Symbol) -> Symbol:
        """Position [m] of the spring's end while the piston is at `position`."""
        return clip(self.dragged, position - 0.5 * self.width, position + 0.5 * self.width)


EFFECTS = (
    FrictionCoulomb, FrictionCoulombDirectional, FrictionStribeck, FrictionViscousDirectional, FrictionPresliding,
    ForceOffset, EndCushion, SpringHardening, Backlash, BacklashPlay,
)  # fmt: skip
