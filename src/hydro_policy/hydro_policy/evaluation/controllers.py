# SPDX-License-Identifier: Apache-2.0
"""Controllers of an evaluation: a trained policy, fixed gains, or fixed gains under the compensated law."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from hydro_core.signals import FloatArray, LawCommand
from hydro_policy.compensation.live import LiveCompensation
from hydro_policy.runs.run_directory import RunDirectory
from hydro_policy.sac.policy import Policy, load_policy
from hydro_policy.task.mdp import ACTION_SIZE, BASE_GAINS, GainRange, observe

PAPER_LAW_COMMAND = LawCommand()


class Controller:
    """Base class of controllers: gain changes at 100 Hz, under a force law."""

    name: str  # for tables
    gain_range: GainRange  # range of the gain changes that it may request
    fixed: tuple[float, float] | None = None  # constant total gains K_p [1/s], K_i [1/s^2]; None: they vary

    @property
    def law(self) -> LawCommand:
        """Force law to command for this controller, with the present coefficients."""
        return PAPER_LAW_COMMAND

    def reset(self) -> None:
        """Reset the controller's state before a run; by default there is none."""

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """Return the gain changes (delta_kp [1/s], delta_ki [1/s^2]) for a sample [14] in the order of STATE_FIELDS."""
        raise NotImplementedError


class FixedGains(Controller):
    """Controller of fixed total gains (K_p, K_i); the box's base gains are subtracted. `kind`: name for tables."""

    def __init__(
        self, proportional: float, integral: float, base: tuple[float, float] = BASE_GAINS, kind: str = "fixed"
    ) -> None:
        if not (math.isfinite(proportional) and math.isfinite(integral)):
            raise ValueError(f"fixed gains are two finite numbers, not {proportional:g} and {integral:g}")
        self.name, self.fixed = f"{kind} ({proportional:g}, {integral:g})", (proportional, integral)
        self._changes = kp, ki = proportional - base[0], integral - base[1]
        self.gain_range = GainRange(delta_kp_min=kp, delta_kp_max=kp, delta_ki_min=ki, delta_ki_max=ki)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        return self._changes


class Compensated(Controller):
    """Controller under the compensated law: its base gains, with coefficients estimated online.

    `compensation`: estimator of the coefficients. `base`: base gains of the paper's law, to which `gain_range` is
    relative as any controller's. `learned`: whether the learned residual is added.
    """

    def __init__(
        self, compensation: LiveCompensation, base: tuple[float, float] = BASE_GAINS, *, learned: bool = False
    ) -> None:
        self.name = "compensated, learned residual" if learned else "compensated"
        self._compensation, self._learned = compensation, learned
        self.fixed = compensation.law.base_kp, compensation.law.base_ki
        self.gain_range = FixedGains(*self.fixed, base).gain_range

    @property
    def law(self) -> LawCommand:
        """Command of the compensated law with its present coefficients."""
        return self._compensation.command

    def reset(self) -> None:
        """Reset the coefficients to `compensation.estimator.INITIAL_COEFFICIENTS`: 1, 0.02 s, 1e-4 s^2, 0 N, 0 s^3."""
        self._compensation.reset(learned=self._learned)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        return 0.0, 0.0


class PolicyController(Controller):
    """Controller that applies the mean action of a trained policy."""

    def __init__(self, policy: Policy, gains: GainRange, name: str) -> None:
        self.name, self.gain_range = name, gains
        self._policy = policy
        self._action: FloatArray = np.zeros(ACTION_SIZE)

    def reset(self) -> None:
        """Discard the previous action."""
        self._action = np.zeros(ACTION_SIZE)

    def gains(self, sample: FloatArray) -> tuple[float, float]:
        """See `Controller`."""
        observation = observe(sample, self._action, self._policy.size)
        if np.isfinite(observation).all():
            self._action = self._policy.act(observation)
        return self.gain_range.gains(self._action)


def policy_controller(path: Path) -> PolicyController:
    """Return the controller of a policy loaded from a run's folder or a file. Raises ValueError: no usable policy."""
    policy, gains, _ = load_policy(policy_file(path))
    return PolicyController(policy, gains, f"policy {path.name if path.is_dir() else path.stem}")


def policy_file(path: Path) -> Path:
    """Return the policy's file: `path` itself, or that of the run in folder `path`."""
    return RunDirectory(path).policy if path.is_dir() else path
