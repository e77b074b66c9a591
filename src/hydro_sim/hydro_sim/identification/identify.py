# SPDX-License-Identifier: Apache-2.0
"""First stage of training the structured model: its constants, by Levenberg-Marquardt on many short windows.

A window's start is not known well enough, so it is estimated along with the constants: every window has its own start
state s, drawn towards its measured samples, and is eliminated from the normal equations (a Schur complement)::

    min over theta, s_1 .. s_n of   sum_i |(readings(theta, s_i) - measured_i) / noise|^2  +  |(s_i - guess_i) /
    spread|^2

    [ A_i  B_i ] [ ds_i   ]     [ a_i ]            (sum_i C_i - B_i' A_i^-1 B_i) dtheta = -(sum_i c_i - B_i' A_i^-1 a_i)
    [ B_i' C_i ] [ dtheta ] = - [ c_i ]

Derivatives are finite differences of rollouts: a column for each learned constant and each of the nine states.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_sim.structured.integration import STATES

CHUNK = 256  # windows whose derivatives are in memory at a time
NUDGE = 1e-4  # of theta
STEP_MAX = 0.5  # of theta in one iteration

Indices = npt.NDArray[np.intp]
Readings = Callable[[FloatArray, FloatArray, slice], FloatArray]
"""(theta, starts of the windows in the slice, slice) -> readings over noise, shape (windows, H * 5)."""


@dataclass
class Fit:
    """State of the search."""

    theta: FloatArray
    starts: FloatArray
    """Shape (n, 9)."""
    damping: float = 1e-2
    costs: list[float] = field(default_factory=list)
    """Mean squared error over noise per reading after each iteration; 1 is what a perfect model leaves."""


@dataclass(frozen=True, kw_only=True)
class _Normal:
    """The normal equations, starts not yet eliminated."""

    a: FloatArray  # (n, 9, 9)
    b: FloatArray  # (n, 9, p)
    c: FloatArray  # (p, p)
    ga: FloatArray  # (n, 9)
    gc: FloatArray  # (p,)

    def step(self, damping: float) -> tuple[FloatArray, FloatArray]:
        """Changes of theta, shape (p,), and of the starts, shape (n, 9), the latter in units of their spread."""
        damped = self.a + damping * self.a * np.eye(STATES)
        solved = np.linalg.solve(damped, np.concatenate((self.b, self.ga[:, :, None]), axis=2))
        reduced = self.c - np.einsum("nip,niq->pq", self.b, solved[:, :, :-1])
        gradient = self.gc - np.einsum("nip,ni->p", self.b, solved[:, :, -1])
        size = np.diag(self.c)
        change = -np.linalg.solve(reduced + np.diag(damping * np.diag(reduced) + 1e-9 * size + 1e-12), gradient)
        change = np.clip(change, -STEP_MAX, STEP_MAX)
        return change, -(solved[:, :, -1] + solved[:, :, :-1] @ change)


def improve(
    fit: Fit, readings: Readings, targets: FloatArray, guesses: FloatArray, spread: FloatArray, learned: Indices
) -> bool:
    """Run one iteration in place; return whether the loss fell by more than a thousandth.

    Parameters
    ----------
    targets
        Measured readings over noise, shape (n, H * 5).
    guesses, spread
        First guess of the starts, shape (n, 9), and its standard deviation, shape (9,).
    learned
        Indices of theta that may move.
    """
    cost = _cost(fit.theta, fit.starts, readings, targets, guesses, spread)
    normal = _normal(fit, readings, targets, guesses, spread, learned)
    while fit.damping < 1e8:
        change, moves = normal.step(fit.damping)
        theta = fit.theta.copy()
        theta[learned] += change
        starts = fit.starts + np.clip(moves, -3.0, 3.0) * spread
        better = _cost(theta, starts, readings, targets, guesses, spread)
        if better < cost:
            fit.theta, fit.starts, fit.damping = theta, starts, max(fit.damping / 10.0, 1e-7)
            fit.costs.append(better)
            return better < 0.999 * cost
        fit.damping *= 10.0
    return False


def _slices(count: int) -> list[slice]:
    return [slice(k, min(k + CHUNK, count)) for k in range(0, count, CHUNK)]


def _cost(
    theta: FloatArray,
    starts: FloatArray,
    readings: Readings,
    targets: FloatArray,
    guesses: FloatArray,
    spread: FloatArray,
) -> float:
    total = float((((starts - guesses) / spread) ** 2).sum())
    for part in _slices(len(starts)):
        total += float(((readings(theta, starts[part], part) - targets[part]) ** 2).sum())
    return total / targets.size if np.isfinite(total) else np.inf


def _normal(
    fit: Fit, readings: Readings, targets: FloatArray, guesses: FloatArray, spread: FloatArray, learned: Indices
) -> _Normal:
    n, p = len(fit.starts), len(learned)
    a, b, ga = np.empty((n, STATES, STATES)), np.empty((n, STATES, p)), np.empty((n, STATES))
    c, gc = np.zeros((p, p)), np.zeros(p)
    for part in _slices(n):
        starts = fit.starts[part]
        base = readings(fit.theta, starts, part)
        columns = []
        for i in range(STATES):
            moved = starts.copy()
            moved[:, i] += 0.01 * spread[i]
            columns.append((readings(fit.theta, moved, part) - base) / 0.01)
        by_state = np.stack(columns, axis=2)
        columns = []
        for i in learned:
            theta = fit.theta.copy()
            theta[i] += NUDGE
            columns.append((readings(theta, starts, part) - base) / NUDGE)
        by_theta = np.stack(columns, axis=2)
        error = base - targets[part]
        a[part] = by_state.transpose(0, 2, 1) @ by_state + np.eye(STATES)
        b[part] = by_state.transpose(0, 2, 1) @ by_theta
        ga[part] = np.einsum("nki,nk->ni", by_state, error) + (starts - guesses[part]) / spread
        flat = by_theta.reshape(-1, p)
        c += flat.T @ flat
        gc += flat.T @ error.ravel()
    return _Normal(a=a, b=b, c=c, ga=ga, gc=gc)
