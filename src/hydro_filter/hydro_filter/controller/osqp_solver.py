# SPDX-License-Identifier: Apache-2.0
"""The filter's quadratic program, solved by OSQP (Stellato et al. 2020) in place of its closed form.

::

    min du^2   such that   a du <= b,   low <= du <= high

The setting `solver: osqp` of the filter node. A box that runs the filter itself has the closed form.
"""

from __future__ import annotations

import math

import numpy as np
import osqp
from scipy.sparse import csc_matrix

SETTINGS = {
    "verbose": False, "eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 500, "check_termination": 5,
    "adaptive_rho": False, "rho": 1.0, "scaling": 0, "polishing": False,
}  # fmt: skip
"""Iterations are limited, not time, so that the same samples have the same result."""


class OsqpSolver:
    """OSQP solver of successive programs, warm-started unless the last one was not solved.

    The program is scaled, du by the larger bound, the half-line by its slope, so that the tolerances mean the same for
    every state of the bench.
    """

    def __init__(self) -> None:
        self._rows = np.array([1.0, 1.0])  # the half-line's slope, the bounds'
        self._lower, self._upper = np.array([-np.inf, -1.0]), np.array([0.0, 1.0])
        self._solver = osqp.OSQP()
        rows = csc_matrix(self._rows[:, np.newaxis])
        self._solver.setup(csc_matrix([[1.0]]), np.zeros(1), rows, self._lower, self._upper, **SETTINGS)

    def solve(self, a: float, b: float, low: float, high: float) -> float:
        """Return du [A]; NaN: not solved.

        Parameters
        ----------
        a, b
            Half-line, [1/A/s] and [1/s].
        low, high
            Bounds of du [A], low <= 0 <= high.
        """
        span = max(-low, high)
        slope = abs(a) * span
        self._rows[0] = math.copysign(1.0, a) if slope > 0.0 else 0.0
        # du is within +-1 here: a level beyond that is out of reach however far, and -2 says so without large numbers
        self._upper[0] = b / slope if slope > -0.5 * b else -2.0
        self._lower[1], self._upper[1] = low / span, high / span
        try:
            self._solver.update(Ax=self._rows, l=self._lower, u=self._upper)
            result = self._solver.solve(raise_error=False)
            if result.info.status_val == osqp.SolverStatus.OSQP_SOLVED:
                return min(max(float(result.x[0]) * span, low), high)
        except (RuntimeError, ValueError):
            pass
        self._solver.warm_start(x=np.zeros(1), y=np.zeros(2))
        return math.nan
