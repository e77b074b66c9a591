# SPDX-License-Identifier: Apache-2.0
"""Actions (eq. policy_action): 2 components in [-1, 1], mapped linearly to gain changes [1/s], [1/s^2]."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from hydro_core.settings import quantity
from hydro_core.signals import FloatArray

ACTION_SIZE = 2

BASE_GAINS = (15.0, 5.0)
"""Base gains K_p [1/s], K_i [1/s^2] of the paper's box (Table training_agent); a box reports its own."""


@dataclass(frozen=True, kw_only=True)
class GainRange:
    """Range of the gain changes: actions in [-1, 1] cover [min, max] (paper Table training_agent)."""

    delta_kp_min: Annotated[float, quantity("1/s", -300.0, 300.0, "Smallest change of K_p")] = 0.0
    delta_kp_max: Annotated[
        float, quantity("1/s", -300.0, 300.0, "Largest change of K_p; 285 on a base gain of 15 reaches K_p = 300")
    ] = 75.0
    delta_ki_min: Annotated[float, quantity("1/s^2", -100.0, 100.0, "Smallest change of K_i")] = 0.0
    delta_ki_max: Annotated[float, quantity("1/s^2", -100.0, 100.0, "Largest change of K_i, above delta_ki_min")] = 10.0

    @classmethod
    def enclosing(cls, *ranges: Any) -> GainRange:
        """Return the smallest range that contains these ranges: objects with the four limits of a `GainRange`."""
        return cls(
            delta_kp_min=min(one.delta_kp_min for one in ranges), delta_kp_max=max(one.delta_kp_max for one in ranges),
            delta_ki_min=min(one.delta_ki_min for one in ranges), delta_ki_max=max(one.delta_ki_max for one in ranges),
        )  # fmt: skip

    def shifted(self, kp: float, ki: float) -> GainRange:
        """Return the range shifted by these amounts: equal total gains on a box with base gains lower by as much."""
        return GainRange(
            delta_kp_min=self.delta_kp_min + kp, delta_kp_max=self.delta_kp_max + kp,
            delta_ki_min=self.delta_ki_min + ki, delta_ki_max=self.delta_ki_max + ki,
        )  # fmt: skip

    def gains(self, action: FloatArray) -> tuple[float, float]:
        """Return (delta_kp, delta_ki) of an action [2] in [-1, 1]."""
        kp, ki = self.changes(action)
        return float(kp), float(ki)

    def changes(self, actions: FloatArray) -> FloatArray:
        """Return the gain changes (delta_kp, delta_ki) of actions in [-1, 1], both of shape (..., 2)."""
        low = np.array((self.delta_kp_min, self.delta_ki_min))
        high = np.array((self.delta_kp_max, self.delta_ki_max))
        return np.asarray(low + 0.5 * (actions + 1.0) * (high - low))

    def action(self, delta_kp: float, delta_ki: float) -> FloatArray:
        """Return the action [2] for these gain changes, without clamping."""
        low = np.array((self.delta_kp_min, self.delta_ki_min))
        high = np.array((self.delta_kp_max, self.delta_ki_max))
        return np.asarray(2.0 * (np.array((delta_kp, delta_ki)) - low) / (high - low) - 1.0)
