# SPDX-License-Identifier: Apache-2.0
"""Effects on the piston's motion besides friction: constant force, cushions, load."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from hydro_sim.model.effects.base import Effect, FitParameter, fit, hidden, parameter
from hydro_sim.model.effects.friction import FORCE_MAX
from hydro_sim.model.equations import Symbol, clip

QUADRATIC_CUSHION_DEPTH = 5e-3
"""Depth [m] at which a quadratic cushion has the force of the linear one."""


class ForceOffset(Effect):
    """A constant force on the piston."""

    id = "force_offset"
    equations = ("motion",)
    family = "friction"
    sentence_template = (
        "A constant force of {force:.3g} N acts on the moving mass (for instance its weight on a slope)."
    )
    force = parameter("N", -1e8, 1e8, scale=5.0, fit=fit(10.0, smallest_reported=0.5, low=-FORCE_MAX, high=FORCE_MAX))

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        return -self.force


class EndCushion(Effect):
    """Cushion at one end of the stroke: a spring with a force linear or quadratic in its depth."""

    id = "end_cushion"
    options = {"form": ("end", "start", "end-quadratic", "start-quadratic")}
    equations = ("motion",)
    family = "spring"
    stiffness = parameter("N/m", 0.0, 1e11, scale=2e4, fit=fit(1e4, smallest_reported=200.0, high=1e7))
    position = parameter("m", -5.0, 5.0, scale=0.01, neutral=0.0, fit=fit(0.0))

    @property
    def sentence_template(self) -> str:  # type: ignore[override]
        side = "beyond" if self.form.startswith("end") else "below"
        return f"The piston runs into a cushion of {{stiffness:.3g}} N/m {side} {{position:.4g}} mm."

    def fitted_parameters(self, bench: Any) -> tuple[FitParameter, ...]:
        """Limit the position to the cushion's half of the stroke: beyond, it would be an offset and a softer spring."""
        stiffness, position = super().fitted_parameters(bench)
        stroke, middle, shares = bench.stroke, 0.5 * bench.stroke, (0.575, 0.625, 0.675)
        low, high = (middle, stroke) if self.form.startswith("end") else (0.0, middle)
        at = shares if self.form.startswith("end") else tuple(1.0 - share for share in shares)
        return stiffness, replace(
            position, low=low, high=high, neutral=middle, start_values=tuple(k * stroke for k in at)
        )

    def opposing_force(self, position: Symbol, velocity: Symbol) -> Symbol:
        beyond = position - self.position
        depth = np.fmax(beyond, 0.0) if self.form.startswith("end") else np.fmin(beyond, 0.0)
        return self.stiffness * depth * (np.abs(depth) / QUADRATIC_CUSHION_DEPTH if "quadratic" in self.form else 1.0)


class _Load(Effect):
    equations = ("load",)
    family = "spring"


class SpringHardening(_Load):
    """Cubic term of the load's spring force."""

    id = "spring_hardening"
    coefficient = parameter("N/m3", -1e11, 1e11, scale=1e7, fit=fit(5e6, smallest_reported=1e5, low=-1e10, high=1e10))

    def sentence(self, values: Mapping[str, float]) -> str:
        change = "hardens" if values["coefficient"] > 0 else "softens"
        return f"The spring {change} with its deflection: {values['coefficient']:.3g} N/m3 times its cube."

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        deflection = position - self.at.bench.spring_rest_position
        return force + self.coefficient * deflection * deflection * deflection


class Backlash(_Load):
    """Gap around the spring's rest position, within which the spring carries no force."""

    id = "backlash"
    sentence_template = "The load has {width:.3g} mm of lost motion around the spring's rest position."
    width = parameter("m", 0.0, 5.0, scale=1e-3, fit=fit(1e-4, 5e-4, 2e-3, smallest_reported=1e-5, high=0.02))

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        n, half = self.at.bench, 0.5 * self.width
        return force - n.spring_stiffness * clip(position - n.spring_rest_position, -half, half)


class BacklashPlay(Backlash):
    """Play in the linkage: the spring is dragged behind the piston, and lags by half the width at each reversal."""

    options = {"form": ("play",)}
    sentence_template = "The load has {width:.3g} mm of lost motion whenever the direction changes."
    single = True
    dragged = hidden("m", scale=1e-2, initial_signal="piston_position")

    def load(self, force: Symbol, position: Symbol) -> Symbol:
        return force - self.at.bench.spring_stiffness * (position - self._end(position))

    def advance_states(self, position: Symbol, velocity: Symbol) -> None:
        self.next["dragged"] = self._end(position)

    def _end(self, position: Symbol) -> Symbol:
        """Position [m] of the spring's end while the piston is at `position`."""
        return clip(self.dragged, position - 0.5 * self.width, position + 0.5 * self.width)


EFFECTS = (ForceOffset, EndCushion, SpringHardening, Backlash, BacklashPlay)
