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

The QP asks for the smallest correction: min |du| such that a du <= b, low <= du <= high. `closed_form` is its algebraic
solution, which never divides by a slope `a` that vanishes. `validate` holds it against OSQP (`validation.osqp`).
"""

from __future__ import annotations

import math
from typing import NamedTuple

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
