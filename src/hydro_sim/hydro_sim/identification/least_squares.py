# SPDX-License-Identifier: Apache-2.0
"""Damped least squares (Levenberg 1944, Marquardt 1963) of `learn` and of the diagnosis."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from hydro_core.signals import FloatArray

Trial = TypeVar("Trial")


def damped_step(
    matrix: FloatArray,
    gradient: FloatArray,
    cost: float,
    attempt: Callable[[FloatArray], tuple[Trial, float]],
    damping: float,
    attempts: int = 4,
) -> tuple[Trial, float, float] | None:
    """Return the first trial that reduces the cost, with its cost and the damping of the next step; None if none does.

    `matrix`, `gradient`: J^T W J, shape (k, k), and J^T W r, shape (k,). `attempt`: returns the trial after a change of
    the k parameters, and its cost. The damping grows twentyfold from trial to trial, and falls to a tenth after one
    that succeeds.
    """
    scale = np.diag(np.diag(matrix) + 1e-12 * np.trace(matrix) + 1e-300)
    for _ in range(attempts):
        change = -np.linalg.lstsq(matrix + damping * scale, gradient, rcond=None)[0]
        trial, reached = attempt(np.asarray(change, dtype=np.float64))
        if reached < cost:
            return trial, reached, 0.1 * damping
        damping *= 20.0
    return None
