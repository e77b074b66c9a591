# SPDX-License-Identifier: Apache-2.0
"""Sparse regression by PySINDy, in its own environment: `python sindy_worker.py IN.npz OUT.json`.

Per equation: weak form (test functions (1 - s^2)^4 of 50 ms, 1500 a recording) by `WeakPDELibrary`; the nominal
model's weak integral is taken off the left side, so that PySINDy has to find the mismatch alone; `STLSQ` on normalised
columns, its threshold chosen on a recording that it is not fitted to (the sparsest within a standard error of the
best), then a fit on all.
"""

from __future__ import annotations

import json
import sys
import warnings
from functools import cache

import numpy as np
import pysindy as ps

THRESHOLDS = np.geomspace(3.0, 3e3, 16)
"""On columns of norm 1 and a left side in units of its noise."""
WINDOWS, HALF = 1500, 0.025
"""Test functions per recording; their half width [s]."""


@cache
def library(samples: int, step: float) -> ps.WeakPDELibrary:
    """Test functions over a recording: the same for every column of every equation."""
    np.random.seed(0)  # noqa: NPY002 - the library draws its windows from there
    time = step * np.arange(samples)
    return ps.WeakPDELibrary(ps.IdentityLibrary(), spatiotemporal_grid=time, K=WINDOWS, H_xt=HALF, p=4)


def weak(time: np.ndarray, columns: np.ndarray, derivative: np.ndarray | None) -> np.ndarray:
    """Weak integrals of columns, shape (WINDOWS, m); of `derivative`, shape (n, 1), the integral of its rate first."""
    over = library(len(time), round(time[1] - time[0], 9))
    made = np.asarray(over.fit_transform([columns])[0])
    if derivative is None:
        return made
    return np.hstack([np.asarray(over.convert_u_dot_integral(derivative)), made])


def regress(parts: list[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, float]:
    """Coefficients and threshold from (terms, target) by recording; the last recording chooses the threshold."""
    train = [np.concatenate(side) for side in zip(*parts[:-1], strict=True)]
    check_terms, check_target = parts[-1]
    errors, spread, sizes = [], [], []
    for threshold in THRESHOLDS:
        square = np.square(check_target - check_terms @ solve(*train, threshold)).ravel()
        errors.append(square.mean())
        spread.append(square.std() / np.sqrt(len(square) / 4.0))  # the windows overlap about fourfold
        sizes.append(threshold)
    best = int(np.argmin(errors))
    enough = [k for k in range(len(sizes)) if errors[k] <= errors[best] + spread[best]]
    chosen = sizes[max(enough)]
    everything = [np.concatenate(side) for side in zip(*parts, strict=True)]
    return solve(*everything, chosen), float(chosen)


def solve(terms: np.ndarray, target: np.ndarray, threshold: float) -> np.ndarray:
    """Coefficients, shape (m,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optimizer = ps.STLSQ(threshold=threshold, alpha=1e-6, normalize_columns=True, max_iter=50)
        return np.asarray(optimizer.fit(terms, target[:, None]).coef_).ravel()


def noise_of(time: np.ndarray, of_state: float, of_rate: float) -> float:
    """Standard deviation of the left side by white noise of the state and of the nominal rate."""
    white = np.random.default_rng(0).standard_normal((len(time), 1))
    sides = weak(time, white, white)
    return float(np.hypot(of_state * sides[:, 0].std(), of_rate * sides[:, 1].std()))


def sides(data: np.lib.npyio.NpzFile, equation: str, run: int) -> tuple[np.ndarray, np.ndarray]:
    """Terms and left side of one equation in one recording, weak form, in units of the noise."""
    state, model, columns, noise = (data[f"{equation}/{what}/{run}"] for what in ("state", "nominal", "terms", "noise"))
    time = data[f"time/{run}"]
    scales = np.maximum(np.abs(columns).max(axis=0), 1e-300)
    if data[f"{equation}/read"]:
        made = weak(time, np.column_stack([state - model, columns / scales]), None)
        left, made = made[:, 0], made[:, 1:]
        sigma = noise_of(time, 0.0, noise[0])
    else:
        made = weak(time, np.column_stack([model, columns / scales]), state[:, None])
        left, made = made[:, 0] - made[:, 1], made[:, 2:]
        sigma = noise_of(time, *noise)
    return made * scales / sigma, left / sigma


def main(source: str, target: str) -> None:
    """Regress every equation of a file."""
    data = np.load(source)
    answer = {}
    for equation in json.loads(str(data["equations"])):
        parts = [sides(data, equation, run) for run in range(int(data["runs"]))]
        coefficients, threshold = regress(parts)
        answer[equation] = {"coefficients": coefficients.tolist(), "threshold": threshold}
    with open(target, "w", encoding="utf-8") as file:
        json.dump(answer, file)


if __name__ == "__main__":
    main(*sys.argv[1:])
