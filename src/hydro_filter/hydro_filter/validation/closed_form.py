# SPDX-License-Identifier: Apache-2.0
"""The filter's quadratic program of one sample: min |du| such that a du <= b, low <= du <= high.

Its algebraic solution is `hydro_closed_form` of firmware/hydro/loop_filter.h, which never divides by a slope `a` that
vanishes. `validate` compares it with OSQP (`validation.osqp_solver`).
"""

from __future__ import annotations

import ctypes
from typing import NamedTuple

from hydro_core.signals import CorrectionStatus
from hydro_filter.model.records import library

LEAST_IMPROVEMENT = 0.01
"""HYDRO_LEAST_IMPROVEMENT: share of the violation that a correction at the valve's limit must remove."""


class Correction(NamedTuple):
    """Solution of the QP."""

    delta_u: float
    """A; 0 if not finite, infeasible, or not needed."""
    status: CorrectionStatus


def solve_qp(a: float, b: float, low: float, high: float) -> Correction:
    """Solve the scalar QP in closed form.

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
    status = ctypes.c_uint32()
    delta_u = library().hydro_c_closed_form(a, b, low, high, ctypes.byref(status))
    return Correction(delta_u, CorrectionStatus(status.value))
