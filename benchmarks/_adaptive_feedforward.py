# SPDX-License-Identifier: Apache-2.0
"""Adaptive feedforwards on top of the compensated law, as peers of the learned residual.

amplitude_phase  what load frames do on sines: the command's amplitude and phase are corrected until the force's
                 fundamental is the reference's. x = (f_r, f_r' / omega), in quadrature on a sine: adaptive feedforward
                 cancellation (Bodson, Sacks, Khosla 1994, IEEE Trans. Autom. Control 39(9), 1939)
filtered_x       adaptive inverse control (Widrow and Walach 1996, Adaptive Inverse Control, chapter 7):
                 x = f_r of the last 0.32 s, the weights by the filtered-x LMS algorithm

Both add p = w x to what the law tracks. The loop from p to the error is modelled as a delay of d steps, so that
filtered x is x delayed, and the step is normalised (Haykin 2002, Adaptive Filter Theory, chapter 6)::

    w(k + 1) = w(k) + mu e(k) x(k - d) / (eps + |x(k - d)|^2)
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_policy.compensation.residual import BEGIN, PREDICTION_MAX, RAMP, RESIDUAL_MAX, Residual

STEP = 0.01
"""s of a policy step."""
DELAY = 2
"""d, policy steps from a decision to the error that it acts on."""
TAPS, APART = 16, 2
"""Of the filter, and policy steps between them."""
RATES = {"amplitude_phase": 0.001, "filtered_x": 0.001}
"""mu of each kind: 0.005 and 0.02 were worse on three truths (--seed 5501)."""
SMALL = 100.0
"""eps [N^2]."""
AVERAGED = STEP / 2.0
"""Per policy step, of the means by which omega is told."""


class Feedforward(Residual):
    """Feedforwards of one kind on n benches; takes a residual's place."""

    def __init__(self, count: int, kind: str) -> None:
        self._kind = kind
        super().__init__(count)

    def reset(self) -> None:
        """Start again, with all weights zero."""
        super().reset()
        n, terms = self._count, 2 if self._kind == "amplitude_phase" else TAPS
        self._weights: FloatArray = np.zeros((n, terms))
        self._seen_x: FloatArray = np.zeros((n, DELAY + 1, terms))
        self._force: FloatArray = np.zeros((n, TAPS * APART))
        self._means: FloatArray = np.zeros((n, 3))  # f_r, its square, f_r'^2
        self._p: FloatArray = np.zeros(n)

    def step(
        self,
        reference: FloatArray,
        rate: FloatArray,
        measured: FloatArray,
        coefficients: FloatArray,
        counted: npt.NDArray[np.bool_],
    ) -> FloatArray:
        """See `Residual.step`."""
        self.age = np.where(counted, self.age + 1, 0)
        x = self._regressors(reference[:, -1], rate[:, -1])
        self._seen_x = np.concatenate((self._seen_x[:, 1:], x[:, np.newaxis]), axis=1)
        acted, error = self._seen_x[:, 0], np.mean(reference - measured, axis=1)
        gain = RATES[self._kind] * np.clip((self.age - BEGIN) / RAMP, 0.0, 1.0) / (SMALL + np.sum(acted**2, axis=1))
        self._weights += (gain * error)[:, np.newaxis] * acted
        p = np.clip(np.sum(self._weights * x, axis=1), -PREDICTION_MAX, PREDICTION_MAX)
        value = coefficients[:, 0] * p + coefficients[:, 1] * (p - self._p) / STEP
        self._p, self.value = p, np.where(counted, np.clip(value, -RESIDUAL_MAX, RESIDUAL_MAX), 0.0)
        return self.value.copy()

    def _regressors(self, force: FloatArray, rate: FloatArray) -> FloatArray:
        if self._kind == "filtered_x":
            self._force = np.concatenate((self._force[:, 1:], force[:, np.newaxis]), axis=1)
            return self._force[:, ::-APART]
        self._means += AVERAGED * (np.stack((force, force**2, rate**2), axis=1) - self._means)
        mean, power, moved = self._means.T
        omega = np.sqrt(moved / np.maximum(power - mean**2, 1.0))
        return np.stack((force - mean, rate / np.maximum(omega, 1.0)), axis=1)
