# SPDX-License-Identifier: Apache-2.0
"""Effects on the piston's motion: friction, cushions, stops, load.

How dry friction holds is part of the model (`model.rates`); its effects give the level at which it yields. With
bristles nothing holds: dF/dx = sigma (1 - F sign(x_p')/level), solved exactly along a step. Sources: Armstrong-Helouvry
et al. 1994, eq. 5; Dahl 1968.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite
from typing import Any

import numpy as np

from hydro_sim.model.effects.base import Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.equations import Symbol, choose, clip

QUADRATIC_DEPTH = 5e-3
"""Depth [m] at which a quadratic cushion has the force of the linear one."""
LEVEL_MIN = 1e-6
"""Lower bound [N] of a bristle's level."""
STRONGEST = 5e3
"""Largest force [N] of a cause, unless the recorded machine is larger."""
HEAVIEST = 1e6
"""Largest damping [N s/m], the same."""


class _Friction(Effect):
    equations = ("motion",)
    family = "friction"


class FrictionCoulomb(_Friction):
    """Constant force against the motion."""

    id = "friction_coulomb"
    says = "Dry friction of {force:.3g} N works against the motion at every speed."
    force = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(10.0, smallest=0.3, high=STRONGEST))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + self.force


class FrictionCoulombDirectional(_Friction):
    """One force while extending, another while retracting."""

    id = "friction_coulomb"
    options = {"form": ("directional",)}
    says = (
        "Dry friction works against the motion: {force_positive:.3g} N while extending, {force_negative:.3g} N "
        "while retracting."
    )
    force_positive = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(10.0, smallest=0.3, high=STRONGEST))
    force_negative = parameter("N", 0.0, 1e8, scale=10.0, fit=fit(6.0, smallest=0.3, high=STRONGEST))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        return level + choose(velocity > 0.0, self.force_positive, self.force_negative)


class FrictionStribeck(_Friction):
    """Additional dry friction near standstill (Armstrong-Helouvry et al. 1994, eq. 5)."""

    id = "friction_stribeck"
    says = (
        "Near standstill friction rises by {breakaway_force:.3g} N; the rise is gone above about {velocity:.3g} mm/s."
    )
    breakaway_force = parameter("N", 0.0, 1e8, scale=5.0, fit=fit(10.0, smallest=0.5, high=STRONGEST))
    velocity = parameter("m/s", 1e-4, 10.0, scale=0.01, neutral=0.01, fit=fit(0.006, 0.02, low=2e-3, high=0.06))

    def dry_level(self, level: Symbol, velocity: Symbol) -> Symbol:
        ratio = velocity / self.velocity
        return level + self.breakaway_force * np.exp(-ratio * ratio)


_VISCOUS = fit(30.0, smallest=1.5, low=-HEAVIEST, high=HEAVIEST)


class FrictionViscousDirectional(_Friction):
    """A change of b while extending, another while retracting."""

    id = "friction_viscous"
    options = {"form": ("directional",)}
    says = (
        "The viscous friction depends on the direction: against the bench file {coefficient_positive:+.4g} N s/m while "
        "extending and {coefficient_negative:+.4g} N s/m while retracting."
    )
    coefficient_positive = parameter("N s/m", -1e9, 1e9, scale=30.0, fit=_VISCOUS)
    coefficient_negative = parameter("N s/m", -1e9, 1e9, scale=30.0, fit=_VISCOUS)

    def fit_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        extending, retracting = super().fit_parameters(bench)
        low = -bench.viscous_friction if isfinite(bench.viscous_friction) else -HEAVIEST
        return replace(extending, low=low), replace(retracting, low=low, probes=(-15.0 if low < -30.0 else 15.0,))

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return choose(velocity > 0.0, self.coefficient_positive, self.coefficient_negative) * velocity


class FrictionPresliding(_Friction):
    """Bristles that bend before they slide, at the level of the other dry friction."""

    id = "friction_presliding"
    says = "Before it slides the piston deflects elastically with {stiffness:.3g} N/m."
    needs = ("friction_coulomb",)
    single = True
    stiffness = parameter("N/m", 1.0, 1e11, scale=2e5, neutral=1e7,
                          fit=fit(3e4, 3e5, low=3e3, high=3e6, neutral=3e6))  # fmt: skip
    bent = hidden("N", scale=5.0)

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        level, moved = self.at.dry_level(velocity), position - self.at.began
        goal = np.sign(moved) * level
        return goal + (self.bent - goal) * np.exp(-self.stiffness * np.abs(moved) / np.fmax(level, LEVEL_MIN))

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["bent"] = self.opposing_force(position, velocity)


class ForceOffset(_Friction):
    """A constant force on the piston."""

    id = "force_offset"
    says = "A constant force of {force:.3g} N acts on the moving mass (for instance its weight on a slope)."
    force = parameter("N", -1e8, 1e8, scale=5.0, fit=fit(10.0, smallest=0.5, low=-STRONGEST, high=STRONGEST))

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return -self.force


class EndCushion(Effect):
    """A spring, or one that hardens, before either end of the stroke."""

    id = "end_cushion"
    options = {"form": ("end", "start", "end-quadratic", "start-quadratic")}
    equations = ("motion",)
    family = "spring"
    stiffness = parameter("N/m", 0.0, 1e11, scale=2e4, fit=fit(1e4, smallest=200.0, high=1e7))
    position = parameter("m", -5.0, 5.0, scale=0.01, neutral=0.0, fit=fit(0.0))

    @property
    def says(self) -> str:  # type: ignore[override]
        side = "beyond" if self.form.startswith("end") else "below"
        return f"The piston runs into a cushion of {{stiffness:.3g}} N/m {side} {{position:.4g}} mm."

    def fit_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        """On its own half of the stroke: beyond, it would be an offset and a softer spring over the whole range."""
        stiffness, position = super().fit_parameters(bench)
        stroke, middle, shares = bench.stroke, 0.5 * bench.stroke, (0.575, 0.625, 0.675)
        low, high = (middle, stroke) if self.form.startswith("end") else (0.0, middle)
        at = shares if self.form.startswith("end") else tuple(1.0 - share for share in shares)
        return stiffness, replace(position, low=low, high=high, neutral=middle, probes=tuple(k * stroke for k in at))

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        beyond = position - self.position
        depth = np.fmax(beyond, 0.0) if self.form.startswith("end") else np.fmin(beyond, 0.0)
        return self.stiffness * depth * (np.abs(depth) / QUADRATIC_DEPTH if "quadratic" in self.form else 1.0)


class _Load(Effect):
    equations = ("load",)
    family = "spring"


class SpringHardening(_Load):
    """A cubic part of the load's spring."""

    id = "spring_hardening"
    coefficient = parameter("N/m3", -1e11, 1e11, scale=1e7, fit=fit(5e6, smallest=1e5, low=-1e10, high=1e10))

    def sentence(self, values: Mapping[str, float]) -> str:
        change = "hardens" if values["coefficient"] > 0 else "softens"
        return f"The spring {change} with its deflection: {values['coefficient']:.3g} N/m3 times its cube."

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        deflection = position - self.at.numbers.spring_rest_position
        return force + self.coefficient * deflection * deflection * deflection


class Backlash(_Load):
    """A gap around the spring's rest, in which it carries nothing."""

    id = "backlash"
    says = "The load has {width:.3g} mm of lost motion around the spring's rest position."
    width = parameter("m", 0.0, 0.1, scale=1e-3, fit=fit(1e-4, 5e-4, 2e-3, smallest=1e-5, high=0.02))

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        n, half = self.at.numbers, 0.5 * self.width
        return force - n.spring_stiffness * clip(position - n.spring_rest_position, -half, half)


class BacklashPlay(Backlash):
    """Play in the linkage: the spring is dragged behind the piston, and lags by half the width at each reversal."""

    options = {"form": ("play",)}
    says = "The load has {width:.3g} mm of lost motion whenever the direction changes."
    single = True
    dragged = hidden("m", scale=1e-2, starts="piston_position")

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
