# SPDX-License-Identifier: Apache-2.0
"""The damped step against closed forms, and against SciPy on Rosenbrock's valley."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from hydro_core.signals import FloatArray
from hydro_sim.identification.least_squares import damped_step

LINE = np.column_stack([np.ones(9), np.linspace(-1.0, 1.0, 9)])


def test_a_step_without_damping_solves_a_linear_problem() -> None:
    residual = LINE @ [3.0, -2.0]
    found = damped_step(
        LINE.T @ LINE, LINE.T @ residual, float(residual @ residual),
        lambda change: (change, float(np.sum((residual + LINE @ change) ** 2))), 0.0,
    )  # fmt: skip
    assert found is not None
    assert found[0] == pytest.approx([-3.0, 2.0]) and found[1] == pytest.approx(0.0, abs=1e-18)


def test_the_damping_grows_until_the_cost_falls_and_none_is_taken_that_raises_it() -> None:
    tried: list[float] = []

    def attempt(change: FloatArray) -> tuple[int, float]:
        tried.append(float(change[0]))
        return len(tried), 0.5 if len(tried) == 3 else float("nan")

    found = damped_step(np.eye(1), np.ones(1), 1.0, attempt, 0.5)
    assert found is not None and found == (3, 0.5, pytest.approx(0.1 * 0.5 * 20.0**2))
    assert tried == pytest.approx([-1.0 / (1.0 + 0.5 * 20.0**k) for k in range(3)])
    assert damped_step(np.eye(1), np.ones(1), 0.2, attempt, 0.5) is None and len(tried) == 7


def test_repeated_steps_reach_the_minimum_that_scipy_finds() -> None:
    def residual(at: FloatArray) -> FloatArray:
        return np.array([10.0 * (at[1] - at[0] ** 2), 1.0 - at[0]])

    at, damping = np.array([-1.2, 1.0]), 1e-2
    for _ in range(60):
        here, slopes = residual(at), np.array([[-20.0 * at[0], 10.0], [-1.0, 0.0]])
        found = damped_step(
            slopes.T @ slopes, slopes.T @ here, float(here @ here),
            lambda change, at=at: (at + change, float(np.sum(residual(at + change) ** 2))), damping, attempts=8,
        )  # fmt: skip
        if found is None:
            break
        at, _, damping = found
    assert at == pytest.approx(least_squares(residual, [-1.2, 1.0], xtol=1e-12).x, abs=1e-6)
