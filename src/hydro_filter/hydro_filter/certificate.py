# SPDX-License-Identifier: Apache-2.0
"""Sampled certificate, with the delay of the correction: decay of v'Mv over the sample in which it acts.

A correction decided at x_k reaches the valve with u_{k+1}. The displacement is therefore first predicted to that time,
with the known current, and the certificate applies to the following sample::

    v_1 = F v_0 + G (K v_0 + w + u_k - u_nom,k)             known: the last correction and saturation are in u_k
    v_2 = F v_1 + G (K v_1 + w) + G du                      the law continues unchanged
    M_c(du) = ( v_2' M v_2 - exp(-2 lambda T) v_1' M v_1 ) / T  <=  margin      [1/s], quadratic in du

As T -> 0 this is eq. cont_require_6 without a projection, for an M that does not change along x. w is the integral's
current beyond its allowance (`excess_integral`). The quadratic's interval of admissible du is exact; the QP gets its
nearer end as half-line a du <= b, whose smallest solution is that of the interval.

The QP asks for the smallest correction: min |du| such that a du <= b, low <= du <= high. `closed_form` is the algebraic
solution: the reference for every solution of OSQP, and the fallback if OSQP has none. `QpFilter` calls OSQP. Neither
ever divides by `a`: scaled to the bounds, a vanishing slope with b < 0 is an ordinary infeasible problem.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import osqp
from scipy.sparse import csc_matrix

from hydro_core.signals import SAMPLE_PERIOD, CorrectionStatus
from hydro_filter.model.coordinates import LOOP
from hydro_sim.jit import njit


@njit
def quadratic(step, metric, v, known, asked, contraction_rate, next_v, after_v):
    """Return bent, slope and level of M_c(du) T = bent du^2 + 2 slope du + level, and v_1'Mv_1.

    `known`, `asked` [A]: u_k - u_nom,k + w, and w. Writes v_1 and v_2 (du = 0).
    """
    if len(v) == LOOP:  # a count that the compiler knows
        return _quadratic(LOOP, step, metric, v, known, asked, contraction_rate, next_v, after_v)
    return _quadratic(len(v), step, metric, v, known, asked, contraction_rate, next_v, after_v)


@njit(inline="always")
def _quadratic(count, step, metric, v, known, asked, contraction_rate, next_v, after_v):
    feedback = known
    for i in range(count):
        feedback += step.feedback[i] * v[i]
    for i in range(count):
        total = step.push[i] * feedback
        for j in range(count):
            total += step.transition[i, j] * v[j]
        next_v[i] = total
    feedback = asked
    for i in range(count):
        feedback += step.feedback[i] * next_v[i]
    for i in range(count):
        total = step.push[i] * feedback
        for j in range(count):
            total += step.transition[i, j] * next_v[j]
        after_v[i] = total
    size, level, slope, bent = 0.0, 0.0, 0.0, 0.0
    for i in range(count):
        now, then, moved = 0.0, 0.0, 0.0
        for j in range(count):
            weight = metric[i, j]
            now += weight * next_v[j]
            then += weight * after_v[j]
            moved += weight * step.push[j]
        size += next_v[i] * now
        level += after_v[i] * then
        slope += step.push[i] * then
        bent += step.push[i] * moved
    return bent, slope, level - math.exp(-2.0 * contraction_rate * SAMPLE_PERIOD) * size, size


@njit
def half_line(bent, slope, level):
    """Return a, b of the half-line with the smallest du of bent du^2 + 2 slope du + level <= 0, and the nearest du.

    The first two are NaN if no du satisfies the inequality; only the third is then valid. `bent` is above 0.
    """
    best = -slope / bent
    if level <= 0.0:
        return 0.0, 0.0, 0.0
    reach = slope * slope - bent * level
    if not reach >= 0.0:
        return math.nan, math.nan, best
    # the nearer root, in the form that does not cancel; it has the sign of -slope
    end = -level / (slope + math.copysign(math.sqrt(reach), slope))
    return (-1.0, -end, best) if end > 0.0 else (1.0, end, best)


@njit
def excess_integral(term, allowance):
    """Return the part of the law's integral I [N/s] beyond `allowance` [N/s]."""
    return term - min(max(term, -allowance), allowance)


@njit
def displacement_share(size, floor):
    """Return the weight, 0 to 1, of a displacement with v'Mv = size: 0 up to `floor`, 1 from twice that."""
    if size <= floor:
        return 0.0
    if not floor > 0.0:
        return 1.0
    share = min(size / floor - 1.0, 1.0)
    return share * share * (3.0 - 2.0 * share)


PASS, MODIFIED, RELAXED = int(CorrectionStatus.PASS), int(CorrectionStatus.MODIFIED), int(CorrectionStatus.RELAXED)
INFEASIBLE, NAN = int(CorrectionStatus.INFEASIBLE), int(CorrectionStatus.NAN)

LEAST_IMPROVEMENT = 0.01
"""Share of the violation that a correction at the valve's limit must remove; otherwise no correction is made."""

AGREEMENT = 1e-6
"""Distance of OSQP's solution from the closed form, relative to the bounds, beyond which the closed form is used."""


class Correction(NamedTuple):
    """Solution of the QP."""

    delta_u: float
    """A; 0 if not finite, infeasible, or not needed."""
    status: CorrectionStatus


def closed_form(a: float, b: float, low: float, high: float) -> Correction:
    """Solve the QP by algebra.

    Parameters
    ----------
    a, b
        Half-line a du <= b, [1/A/s] and [1/s].
    low, high
        Bounds of du [A], low <= 0 <= high.

    Returns
    -------
    Correction
        PASS: du = 0 satisfies it. MODIFIED: du = b/a. RELAXED: du at the bound next to b/a. INFEASIBLE: no bound
        within reach removes a share of `LEAST_IMPROVEMENT` of the violation; du = 0. NAN: an argument is not finite,
        or zero is not within the bounds; du = 0.
    """
    delta_u, status = closed_form_kernel(a, b, low, high)
    return Correction(delta_u, CorrectionStatus(status))


@njit
def closed_form_kernel(a, b, low, high):
    """Return the result of `closed_form`, for compiled code: du [A] and the status' number."""
    if not (math.isfinite(a) and math.isfinite(b) and -math.inf < low <= 0.0 <= high < math.inf):
        return 0.0, NAN
    if b >= 0.0:
        return 0.0, PASS
    bound = low if a > 0.0 else high
    reach = a * bound  # the smallest a du there is, 0 or less
    if reach <= b:
        return b / a, MODIFIED  # |b/a| <= |bound|: a cannot vanish here
    if reach > LEAST_IMPROVEMENT * b:
        return 0.0, INFEASIBLE
    return bound, RELAXED


@dataclass
class QpCounts:
    """Statistics of OSQP."""

    solved: int = 0
    infeasible: int = 0
    """OSQP and the closed form agree that the certificate cannot be restored."""
    fallbacks: int = 0
    """OSQP failed or disagreed; the closed form was used."""


class QpFilter:
    """Solver of the QP by OSQP, warm-started from the last solution, cold-started after any status but solved.

    The problem is scaled: du by the larger bound, the half-line by its slope, so that the tolerances mean the same for
    every state of the bench.
    """

    def __init__(self) -> None:
        self.counts = QpCounts()
        self._rows = np.array([1.0, 1.0])  # the half-line's slope, the bounds'
        self._lower = np.array([-np.inf, -1.0])
        self._upper = np.array([0.0, 1.0])
        self._solver = osqp.OSQP()
        self._solver.setup(
            csc_matrix([[1.0]]),
            np.zeros(1),
            csc_matrix(self._rows[:, np.newaxis]),
            self._lower,
            self._upper,
            verbose=False,
            eps_abs=1e-9,
            eps_rel=1e-9,
            max_iter=500,
            check_termination=5,
            adaptive_rho=False,
            rho=1.0,
            scaling=0,
            polishing=False,
        )

    def solve(self, a: float, b: float, low: float, high: float) -> Correction:
        """Solve the QP as `closed_form` does, by OSQP. Never raises; `counts` records failures of OSQP."""
        oracle = closed_form(a, b, low, high)
        if oracle.status in (CorrectionStatus.PASS, CorrectionStatus.NAN):
            return oracle  # du = 0 is optimal, or there is no problem to solve
        span = max(-low, high)
        solution = self._ask(a, b, low, high, span) if span > 0.0 else math.nan
        restored = oracle.status is CorrectionStatus.MODIFIED
        if math.isnan(solution) and not restored:
            self.counts.infeasible += 1
        elif abs(solution - oracle.delta_u) <= AGREEMENT * span:
            self.counts.solved += 1
            return Correction(min(max(solution, low), high), oracle.status) if restored else oracle
        else:
            self.counts.fallbacks += 1
        return oracle

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
        except (RuntimeError, ValueError):
            self._restart()
            return math.nan
        if result.info.status_val != osqp.SolverStatus.OSQP_SOLVED:
            self._restart()
            return math.nan
        return float(result.x[0]) * span

    def _restart(self) -> None:
        self._solver.warm_start(x=np.zeros(1), y=np.zeros(2))
