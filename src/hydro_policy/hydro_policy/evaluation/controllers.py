# SPDX-License-Identifier: Apache-2.0
"""Controllers of an evaluation: a trained policy, fixed gains, or fixed gains under the compensated law."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from hydro_core.signals import FloatArray, LawCommand
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.runs.run import RunDirectory
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.task.mdp import ACTIONS, BASE, GainRange, observe


class Controller(Protocol):
    """Chooses gains at 100 Hz."""

    @property
    def name(self) -> str:
        """Name for tables."""

    def reset(self) -> None:
        """Reset before a run; nothing where there is no state."""
        return

    @property
    def reach(self) -> GainRange:
        """Range of the gain changes that it may request."""

    @property
    def law(self) -> LawCommand:
        """Force law that it needs, as of now; the paper's by default."""
        return LawCommand()

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """Return (delta_kp [1/s], delta_ki [1/s^2]) for a sample [14] in the order of STATE_FIELDS."""


@dataclass(frozen=True)
class FixedGains(Controller):
    """Fixed gains, given as totals (K_p, K_i); the box's base gains are subtracted."""

    proportional: float
    integral: float
    base: tuple[float, float] = BASE
    kind: str = "fixed"  # for tables

    def __post_init__(self) -> None:
        if not (math.isfinite(self.proportional) and math.isfinite(self.integral)):
            raise ValueError(f"fixed gains are two finite numbers, not {self.proportional:g} and {self.integral:g}")

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.kind} ({self.proportional:g}, {self.integral:g})"

    @property
    def reach(self) -> GainRange:
        """Range of a single point."""
        kp, ki = self.proportional - self.base[0], self.integral - self.base[1]
        return GainRange(delta_kp_min=kp, delta_kp_max=kp, delta_ki_min=ki, delta_ki_max=ki)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        return self.proportional - self.base[0], self.integral - self.base[1]


class Compensated:
    """Base gains of the compensated law, whose coefficients follow the bench.

    `compensation`: estimator of the coefficients. `base`: base gains of the paper's law, to which `reach` is relative
    as any controller's. `learned`: whether the learned residual is added.
    """

    def __init__(
        self, compensation: LiveCompensation, base: tuple[float, float] = BASE, *, learned: bool = False
    ) -> None:
        self.name = "compensated, learned residual" if learned else "compensated"
        self._learned = learned
        self._compensation, law = compensation, compensation.law
        self.proportional, self.integral = law.base_kp, law.base_ki
        self.reach = FixedGains(law.base_kp, law.base_ki, base).reach

    @property
    def law(self) -> LawCommand:
        """The compensated law with the present coefficients."""
        return self._compensation.command

    def reset(self) -> None:
        """Begin with neutral coefficients."""
        self._compensation.reset(learned=self._learned)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        return 0.0, 0.0


class PolicyController:
    """Mean action of a trained policy."""

    law = LawCommand()

    def __init__(self, policy: Policy, gains: GainRange, name: str) -> None:
        self.name, self.reach = name, gains
        self._policy = policy
        self._action: FloatArray = np.zeros(ACTIONS)

    def reset(self) -> None:
        """Discard the previous action."""
        self._action = np.zeros(ACTIONS)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        observation = observe(sample, self._action, self._policy.size)
        if np.isfinite(observation).all():
            self._action = self._policy.act(observation)
        return self.reach.gains(self._action)


def policy_controller(path: Path) -> PolicyController:
    """Load the policy of a run's folder, or of a file. Raises ValueError: neither exists."""
    policy, gains, _ = load_policy(policy_file(path))
    return PolicyController(policy, gains, f"policy {path.name if path.is_dir() else path.stem}")


def policy_file(path: Path) -> Path:
    """Return the policy's file: `path` itself, or that of the run in folder `path`."""
    return RunDirectory(path).policy if path.is_dir() else path
