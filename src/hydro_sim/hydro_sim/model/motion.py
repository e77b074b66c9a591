# SPDX-License-Identifier: Apache-2.0
"""Stick-slip of the mass under dry friction: an exact event within an integration step.

Friction brings the mass to rest within the step as far as its level reaches, and then holds it: the velocity is 0, not
small. Otherwise it works against the motion at its level. Derivatives are those of the side on which the step is: a
mass that is held stays held, whatever changes a little.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from hydro_sim.model.equations import Symbol, choose

STANDSTILL = 1e-9
"""Smallest speed [m/s] at which a level that depends on the direction is evaluated."""


@dataclass(frozen=True)
class DryFriction:
    """Effect of dry friction over a step."""

    level: Callable[[Symbol], Symbol]
    """N, at a velocity [m/s]."""
    sign: Symbol
    """Sign of the motion that it opposes."""
    held: Symbol
    """Whether it brings the mass to rest."""
    holding: Symbol
    """The force [N] that does."""

    def force(self, velocity: Symbol) -> Symbol:
        """N, against the motion."""
        return choose(self.held, self.holding, self._sliding(velocity))

    def end(self, velocity: Symbol) -> Symbol:
        """Velocity [m/s] where the step has ended."""
        return choose(self.held, 0.0, velocity)

    def _sliding(self, velocity: Symbol) -> Symbol:
        return self.sign * self.level(self.sign * np.fmax(np.abs(velocity), STANDSTILL))


def stick_event(
    level: Callable[[Symbol], Symbol], mass: Symbol, velocity: Symbol, free: Symbol, step: float
) -> DryFriction:
    """Effect over a step [s] that begins at a velocity [m/s] and, without friction, an acceleration `free` [m/s2]."""
    holding = mass * (velocity / step + free)
    sign = choose(holding >= 0.0, 1.0, -1.0)
    reach = level(sign * np.fmax(np.abs(velocity), STANDSTILL))
    return DryFriction(level, sign, np.abs(holding) < reach, holding)
