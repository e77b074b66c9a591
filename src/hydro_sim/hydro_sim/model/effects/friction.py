# SPDX-License-Identifier: Apache-2.0
"""Friction of the piston: Coulomb, Stribeck, viscous, presliding.

Sticking by dry friction is part of the model (`model.rates`); the effects give its breakaway level. With bristles
nothing sticks: dF/dx = sigma (1 - F sign(x_p')/level), solved exactly along a step. Sources: Armstrong-Helouvry
et al. 1994, eq. 5; Dahl 1968.
"""

from __future__ import annotations

from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np

from hydro_sim.model.effects.base import Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.equations import Symbol, choose

LEVEL_MIN = 1e-6
"""Lower bound [N] of a bristle's level."""
FORCE_MAX = 5e3
"""Largest force [N] of a cause, unless the recorded machine is larger."""
DAMPING_MAX = 1e6
"""Largest damping [N s/m] of a cause, unless the recorded machine is larger."""


class _Friction(Effect):
    equations = ("motion",)
    family = "friction"


class FrictionCoulomb(_Friction):
    """Coulomb friction: a constant force against the motion."""

    id = "friction_coulomb"
    sentence_template = "Dry friction of {force:.3g} N works against the motion."
    force = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(10.0, smallest_reported=0.3, high=FORCE_MAX))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + self.force


class FrictionCoulombDirectional(_Friction):
    """Coulomb friction with one level while extending, another while retracting."""

    id = "friction_coulomb"
    options = {"form": ("directional",)}
    sentence_template = (
        "Dry friction works against the motion: {force_positive:.3g} N while extending, {force_negative:.3g} N "
        "while retracting."
    )
    force_positive = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(10.0, smallest_reported=0.3, high=FORCE_MAX))
    force_negative = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(6.0, smallest_reported=0.3, high=FORCE_MAX))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + choose(velocity > 0.0, self.force_positive, self.force_negative)


class FrictionStribeck(_Friction):
    """Additional dry friction near standstill (Armstrong-Helouvry et al. 1994, eq. 5)."""

    id = "friction_stribeck"
    sentence_template = (
        "Near standstill friction rises by {breakaway_force:.3g} N; the rise is gone above about {velocity:.3g} mm/s."
    )
    breakaway_force = parameter("N", 0.0, 1e8, scale=5.0, fit=fit(10.0, smallest_reported=0.5, high=FORCE_MAX))
    velocity = parameter("m/s", 1e-4, 10.0, scale=0.01, neutral=0.01, fit=fit(0.006, 0.02, low=2e-3, high=0.06))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        ratio = velocity / self.velocity
        return level + self.breakaway_force * np.exp(-ratio * ratio)


_VISCOUS = fit(30.0, smallest_reported=1.5, low=-DAMPING_MAX, high=DAMPING_MAX)


class FrictionViscousDirectional(_Friction):
    """Change of the viscous friction b while extending, and another while retracting."""

    id = "friction_viscous"
    options = {"form": ("directional",)}
    sentence_template = (
        "The viscous friction depends on the direction: against the bench file {coefficient_positive:+.4g} N s/m while "
        "extending and {coefficient_negative:+.4g} N s/m while retracting."
    )
    coefficient_positive = parameter("N s/m", -1e9, 1e9, scale=30.0, fit=_VISCOUS)
    coefficient_negative = parameter("N s/m", -1e9, 1e9, scale=30.0, fit=_VISCOUS)

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        extending, retracting = super().fitted_parameters(bench)
        low, usual = (-bench.viscous_friction if isfinite(bench.viscous_friction) else extending.low), extending.span
        start = -0.5 * usual if low < -usual else 0.5 * usual
        return replace(extending, low=low), replace(retracting, low=low, start_values=(start,))

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return choose(velocity > 0.0, self.coefficient_positive, self.coefficient_negative) * velocity


class FrictionPresliding(_Friction):
    """Presliding: bristles that deflect until they slide at the level of the other dry friction."""

    id = "friction_presliding"
    sentence_template = "Before it slides the piston deflects elastically with {stiffness:.3g} N/m."
    needs = ("friction_coulomb",)
    single = True
    stiffness = parameter("N/m", 1e-9, 1e11, scale=2e5, neutral=1e7,
                          fit=fit(3e4, 3e5, low=3e3, high=3e6, neutral=3e6))  # fmt: skip
    bent = hidden("N", scale=5.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        level, moved = self.at.dry_level(velocity), position - self.at.initial_position
        goal = np.sign(moved) * level
        return goal + (self.bent - goal) * np.exp(-self.stiffness * np.abs(moved) / np.fmax(level, LEVEL_MIN))

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["bent"] = self.opposing_force(position, velocity)


EFFECTS = (
    FrictionCoulomb, FrictionCoulombDirectional, FrictionStribeck, FrictionViscousDirectional, FrictionPresliding,
)  # fmt: skip
