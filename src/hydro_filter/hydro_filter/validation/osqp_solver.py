# SPDX-License-Identifier: Apache-2.0
"""The filter's QP solved by OSQP, independently of its closed form."""

from __future__ import annotations

import math

import numpy as np
import osqp
from scipy.sparse import csc_matrix

from hydro_core.signals import CorrectionStatus
from hydro_filter.validation.closed_form import solve_qp

AGREEMENT_TOLERANCE = 1e-6
"""Distance between both solutions, relative to the bounds, up to which they agree; OSQP's own tolerance is 1e-9."""

OSQP_SETTINGS = {
    "verbose": False, "eps_abs": 1e-9, "eps_rel": 1e-9, "max_iter": 500, "check_termination": 5,
    "adaptive_rho": False, "rho": 1.0, "scaling": 0, "polishing": False,
}  # fmt: skip


class Osqp:
    """OSQP solver of the filter's QP, warm-started unless the last status was not `solved`.

    The problem is scaled: du by the larger bound, the half-line by its slope, so that the tolerances mean the same for
    every state of the bench.
    """

    def __init__(self) -> None:
        self.agreed = self.differed = 0
        """Problems in which OSQP and the closed form agree: on du, or that none restores the certificate."""
        self._rows = np.array([1.0, 1.0])  # the half-line's slope, the bounds'
        self._lower = np.array([-np.inf, -1.0])
        self._upper = np.array([0.0, 1.0])
        self._solver = osqp.OSQP()
        rows = csc_matrix(self._rows[:, np.newaxis])
        self._solver.setup(csc_matrix([[1.0]]), np.zeros(1), rows, self._lower, self._upper, **OSQP_SETTINGS)

    def compare(self, a: float, b: float, low: float, high: float) -> None:
        """Solve the QP of `closed_form.solve_qp` and count whether both agree; skipped where du = 0 solves it."""
        exact = solve_qp(a, b, low, high)
        if exact.status in (CorrectionStatus.PASS, CorrectionStatus.NAN) or not high > low:
            return
        span = max(-low, high)
        found = self._ask(a, b, low, high, span)
        none = math.isnan(found) and exact.status is not CorrectionStatus.MODIFIED
        agree = none or abs(found - exact.delta_u) <= AGREEMENT_TOLERANCE * span
        self.agreed += agree
        self.differed += not agree

    def _ask(self, a: float, b: float, low: float, high: float, span: float) -> float:
        """Return OSQP's du [A], NaN if it finds none."""
        slope = abs(a) * span
        self._rows[0] = math.copysign(1.0, a) if slope > 0.0 else 0.0
        # du is within +-1 here: a level beyond that is out of reach however far, and -2 says so without large numbers
        self._upper[0] = b / slope if slope > -0.5 * b else -2.0
        self._lower[1], self._upper[1] = low / span, high / span
        try:
            self._solver.update(Ax=self._rows, l=self._lower, u=self._upper)
            result = self._solver.solve(raise_error=False)
            if result.info.status_val == osqp.SolverStatus.OSQP_SOLVED:
                return float(result.x[0]) * span
        except (RuntimeError, ValueError):
            pass
        self._solver.warm_start(x=np.zeros(1), y=np.zeros(2))
        return math.nan
