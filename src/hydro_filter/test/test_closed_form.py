# SPDX-License-Identifier: Apache-2.0
"""The filter's quadratic program: OSQP against the closed form, and the closed form against its own conditions."""

from __future__ import annotations

import ctypes
from math import inf, nan

import numpy as np
import pytest

from hydro_core.signals import CorrectionStatus
from hydro_filter.model.records import library

U_MAX = 0.05
LEAST_IMPROVEMENT = 0.01
"""HYDRO_LEAST_IMPROVEMENT of firmware/hydro/loop_filter.h."""
SOLVED = {CorrectionStatus.PASS, CorrectionStatus.MODIFIED}


def solve_qp(a: float, b: float, low: float, high: float) -> tuple[float, CorrectionStatus]:
    """The closed form of firmware/hydro/loop_filter.h."""
    status = ctypes.c_uint32()
    delta_u = library().hydro_c_closed_form(a, b, low, high, ctypes.byref(status))
    return delta_u, CorrectionStatus(status.value)


def cases(count: int, seed: int) -> np.ndarray:
    """a, b, low, high over thirty decades of slope, with zeros, signs and valves at their limit; shape (count, 4)."""
    rng = np.random.default_rng(seed)
    a = rng.choice([-1.0, 1.0], count) * 10.0 ** rng.uniform(-15, 15, count)
    a[rng.random(count) < 0.05] = 0.0
    # half of the cases near where b/a meets a bound, the rest anywhere
    near = rng.random(count) < 0.5
    bounds = -np.abs(a) * U_MAX * 10.0 ** rng.uniform(-3, 2.5, count)
    b = np.where(near, bounds, rng.normal(size=count) * 10.0 ** rng.uniform(-9, 6, count))
    applied = rng.choice([-U_MAX, 0.0, U_MAX, nan], count)
    applied = np.where(np.isnan(applied), rng.uniform(-U_MAX, U_MAX, count), applied)
    return np.column_stack([a, b, -U_MAX - applied, U_MAX - applied])


def test_what_is_not_finite_or_leaves_out_zero_has_no_closed_form() -> None:
    rng, problems = np.random.default_rng(1), cases(2000, seed=2)
    problems[np.arange(2000), rng.integers(0, 4, 2000)] = rng.choice([nan, inf, -inf], 2000)
    shifted = cases(2000, seed=3)
    shifted[:, 2:] += rng.choice([-1.0, 1.0], (2000, 1)) * 10.0 * U_MAX
    for problem in (*problems, *shifted):
        assert solve_qp(*problem) == (0.0, CorrectionStatus.NAN), problem


def test_closed_form_is_feasible_and_smallest() -> None:
    """Against a grid of the admissible corrections, which knows no algebra."""
    for a, b, low, high in cases(2000, seed=3):
        delta_u, status = solve_qp(a, b, low, high)
        grid = np.concatenate([np.linspace(low, high, 401), [0.0]])
        fitting = grid[a * grid <= b]
        if status in SOLVED:
            assert a * delta_u <= b + 1e-9 * (abs(b) + abs(a) * U_MAX)
            assert fitting.size == 0 or abs(delta_u) <= np.abs(fitting).min() + 1e-12
        else:
            assert fitting.size == 0
            best = (a * grid).min()
            wanted = best if best <= LEAST_IMPROVEMENT * b else 0.0
            assert a * delta_u == pytest.approx(wanted, rel=1e-9, abs=1e-300)


@pytest.mark.parametrize("a", [0.0, 1e-300, -1e-300, 5e-324])
def test_a_vanishing_slope_is_infeasible_not_a_full_stroke(a: float) -> None:
    assert solve_qp(a, -1.0, -0.05, 0.05) == (0.0, CorrectionStatus.INFEASIBLE)
