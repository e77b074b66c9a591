# SPDX-License-Identifier: Apache-2.0
"""What the figures of a table were made under: without it two tables cannot be compared."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from hydro_policy.task.mdp import BASE, GainRange


@dataclass(frozen=True, kw_only=True)
class Conditions:
    """Of all runs of an evaluation."""

    plant: str
    """What was controlled, for people: `emulator, truth worn.yaml`."""
    bench: str
    """What the box believed: digest and source; empty: it did not say."""
    filter: str
    """Words of the filter that stood between; empty: not known, it ran already."""
    integral: str = ""
    """Form of the law's integral, `bumpless` or `paper`; empty: the box did not say."""
    base_gains: tuple[float, float] = BASE
    """K_p [1/s] and K_i [1/s^2] of the box."""

    @property
    def sentence(self) -> str:
        """One line under a table."""
        filtered = self.filter or "the one that ran already"
        integral = self.integral or "not told"
        return f"Plant {self.plant}; box bench {self.bench or 'not told'}; filter {filtered}; integral {integral}"

    def authority(self, reach: GainRange) -> str:
        """K_p [1/s] and K_i [1/s^2] in all that a controller may ask for."""
        kp, ki = self.base_gains
        proportional = _range(kp + reach.delta_kp_min, kp + reach.delta_kp_max)
        return f"{proportional}, {_range(ki + reach.delta_ki_min, ki + reach.delta_ki_max)}"

    def plain(self) -> dict[str, Any]:
        """As JSON types."""
        return {**asdict(self), "base_gains": list(self.base_gains)}


def _range(low: float, high: float) -> str:
    return f"{low:g}" if low == high else f"{low:g} to {high:g}"
