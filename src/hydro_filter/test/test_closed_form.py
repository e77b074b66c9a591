# SPDX-License-Identifier: Apache-2.0
"""OSQP against the closed form, and the closed form against its own conditions."""

from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest

from hydro_core.signals import CorrectionStatus
from hydro_filter.validation.closed_form import LEAST_IMPROVEMENT, solve_qp
from hydro_filter.validation.osqp_solver import Osqp

U_MAX = 0.05
SOLVED = {CorrectionStatus.PASS, CorrectionStatus.MODIFIED}
UNSOLVED = {CorrectionStatus.RELAXED, CorrectionStatus.INFEASIBLE, CorrectionStatus.NAN}


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


def test_osqp_agrees_with_the_closed_form() -> None:
    """One solver, all problems in turn: what a bad one leaves behind would show in the next.

    Bad: an entry that is not finite, or bounds that leave out zero, as of a u_nom beyond the valve.
    """
    rng, problems, osqp, seen = np.random.default_rng(1), cases(10_000, seed=1), Osqp(), set()
    rows = np.flatnonzero(rng.random(len(problems)) < 0.05)
    problems[rows, rng.integers(0, 4, len(rows))] = rng.choice([nan, inf, -inf], len(rows))
    rows = np.flatnonzero(rng.random(len(problems)) < 0.05)
    problems[rows, 2:] += rng.choice([-1.0, 1.0], (len(rows), 1)) * 10.0 * U_MAX
    for a, b, low, high in problems:
        osqp.compare(a, b, low, high)
        assert not osqp.differed, (a, b, low, high)
        delta_u, status = solve_qp(a, b, low, high)
        unusable = not np.isfinite([a, b, low, high]).all() or not low <= 0.0 <= high
        assert (status is CorrectionStatus.NAN) == unusable, (a, b, low, high)
        assert delta_u == 0.0 if unusable else low <= delta_u <= high
        seen.add(status)
    assert seen == SOLVED | UNSOLVED and osqp.agreed > 4000


def test_a_wrong_answer_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    osqp = Osqp()
    monkeypatch.setattr(osqp, "_ask", lambda *problem: nan)
    osqp.compare(2.0, -0.05, -0.05, 0.05)
    assert (osqp.agreed, osqp.differed) == (0, 1)


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
