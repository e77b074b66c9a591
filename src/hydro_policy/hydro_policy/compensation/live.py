# SPDX-License-Identifier: Apache-2.0
"""Online adaptation of the compensated law: estimator and learned residual on the samples of a live bench.

    /hydro/law_state  f_c, as it acted ──┐ by sequence   ten samples of a policy step     Compensator
    /hydro/state      f, flags ──────────┴──────────────> complete, and all of them good ────────────> a_0 to a_3

The estimate holds over a policy step with a missing or unusable sample: disarmed, saturated, tripped, under another
law, with late commands (FILTER_STALE under this law), or with an implausible force.

With `learned`, the prediction of the learned residual (`residual`) is added to a_3.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from hydro_bridge.safety.guard import safe_command
from hydro_bridge.serial.protocol import BoxLaw
from hydro_core.signals import SAMPLES_PER_STEP, Flag, FloatArray, Law, LawCommand
from hydro_policy.compensation.estimator import VALIDITY_MASK, Compensator, CompensatorSettings, LoadCell
from hydro_policy.compensation.residual import AdaptedLaw, Network, Residual

LAW_STATE_LIFETIME = 50  # samples for which the last /hydro/law_state is valid; none is published under the paper's law

_BUFFERED_STEPS_MAX = LAW_STATE_LIFETIME // SAMPLES_PER_STEP + 2
"""Incomplete policy steps that are buffered, so that valid law messages find their samples on a busy machine, too."""


@dataclass
class _Step:
    """Samples of one policy step."""

    signals: FloatArray = field(default_factory=lambda: np.full((4, SAMPLES_PER_STEP), np.nan))
    """f_c, f [N], f_r' [N/s], f_r [N], shape (4, 10); NaN: not received yet."""
    good: bool = True


class LiveCompensation:
    """Online estimator of the compensated law's coefficients for one box, with an optional learned residual.

    `law`: the box's compensated law. `settings`, `cell`: see `Compensator`. `network`: network of the learned residual;
    None: the residual is zero.
    """

    def __init__(
        self,
        law: BoxLaw,
        settings: CompensatorSettings | None = None,
        cell: LoadCell | None = None,
        network: Network | None = None,
    ) -> None:
        self.law, self.cell = law, cell
        self.uncounted_steps = 0  # policy steps whose samples were excluded from the estimate
        self._estimator = Compensator(1, settings, law, cell)
        self._residual = Residual(1, network, self._estimator.settings.force_scale)
        self._adapted = AdaptedLaw(self._estimator, self._residual)
        self._adapted.learned = False
        self._safe = safe_command(law)
        self._steps: dict[int, _Step] = {}
        self._last_step, self._last_law, self._last_sample = -1, -1, -1
        self._take(_Step(), good=False)  # loads the compiled code, which takes a second, before arming
        self.uncounted_steps = 0
        self.reset()

    def reset(self, *, learned: bool = False) -> None:
        """Reset estimator, residual, and coefficients to `estimator.INITIAL_COEFFICIENTS`; frozen ones are kept.

        `learned`: whether the learned residual acts from now on; it does not while the coefficients are frozen.
        """
        self._adapted.reset(learned=learned)
        self._steps.clear()

    @property
    def frozen(self) -> bool:
        """Whether the coefficients are frozen at a person's request; settable."""
        return bool(self._estimator.frozen[0])

    @frozen.setter
    def frozen(self, frozen: bool) -> None:
        self._estimator.frozen[:] = frozen

    @property
    def acting(self) -> Law:
        """Force law that acts, by the last message on /hydro/law_state."""
        told = (
            self._last_law >= 0
            and (self._last_sample - self._last_law + LAW_STATE_LIFETIME) & 0xFFFFFFFF < 2 * LAW_STATE_LIFETIME
        )
        return Law.COMPENSATED if told else Law.PAPER

    @property
    def command(self) -> LawCommand:
        """Command of the compensated law with its present coefficients."""
        a_0, a_1, a_2, a_3, a_4 = self._adapted.coefficients[0].tolist()
        return replace(self._safe, coefficients=(a_0, a_1, a_2, a_3, a_4))

    @property
    def health(self) -> dict[str, object]:
        """Status values of estimator and residual for /diagnostics, by name."""
        values = self._estimator.coefficients[0]
        return {
            **{f"a_{i}": float(value) for i, value in enumerate(values)},
            "excitation": float(self._estimator.excitation[0]),
            "at a bound": "yes" if self._estimator.at_bound[0] else "no",
            "frozen": "yes, by a person" if self.frozen else "no",
            "policy steps held": self.uncounted_steps,
            "learned residual [N]": float(self._adapted.added[0]) if self._adapted.learned else "off",
            "its authority": float(self._residual.authority[0]) if self._adapted.learned else "off",
        }

    def on_law_state(self, sequence: int, law: int, compensated_reference: float) -> None:
        """Process a sample's law state: the force law that acted, and its compensated reference f_c [N]."""
        self._last_law = sequence
        self._enter(sequence, slice(0, 1), compensated_reference, law == Law.COMPENSATED)

    def on_sample(
        self,
        sequence: int,
        force: float,
        flags: int,
        reference_rate: float = 0.0,
        *,
        reference: float = 0.0,
        excluded: bool = False,
    ) -> None:
        """Process a sample: f [N], flags, f_r' [N/s], f_r [N]; `excluded`: whether its policy step is not used."""
        self._last_sample = sequence
        good = flags & (VALIDITY_MASK | Flag.FILTER_STALE) == Flag.ARMED and not excluded
        self._enter(sequence, slice(1, 4), (force, reference_rate, reference), good)

    def _enter(self, sequence: int, rows: slice, values: Any, good: bool) -> None:
        """Store signals of a sample; update the estimate once its policy step is complete."""
        number, index = divmod(sequence - 1, SAMPLES_PER_STEP)
        if number not in self._steps:
            self._steps = {n: step for n, step in self._steps.items() if abs(number - n) < _BUFFERED_STEPS_MAX}
            self._steps[number] = _Step()
        step = self._steps[number]
        step.signals[rows, index] = values
        step.good &= good
        if not np.isfinite(step.signals[:2]).all():
            return
        del self._steps[number]
        if number != self._last_step + 1:  # samples are missing: the estimator's filter restarts
            self._take(step, good=False)
        self._last_step = number
        self._take(step, good=step.good)

    def _take(self, step: _Step, *, good: bool) -> None:
        commanded, measured, rate, reference = step.signals[:, np.newaxis]
        self._adapted.step(commanded, measured, np.array([good]), rate, reference)
        self.uncounted_steps += not self._estimator.counted[0]
