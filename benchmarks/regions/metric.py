# SPDX-License-Identifier: Apache-2.0
"""Metric of a region by semidefinite programming, with constraints at vertices that are added in rounds.

For H = [F + G K, D] of every bench, state and gain of the region, a set of matrices by `verify_region.sample`::

    H' M(K_p+) H  <=  diag( exp(-2 lambda T) M(K_p), (1 - exp(-2 lambda T)) W )

The first block is the contraction; all of it says that disturbances w with w'Ww <= 1 do not leave v'Mv <= 1. Largest t
with M(K_p) >= t e e' for all K_p, e along f_l: t = (f/tube)^2 for the force's unit f, so that the tube is the smallest
that a quadratic form can prove. The left side is convex in H: a program of some vertices is solved, those that its
solution violates most are added, and so on. Solved by Clarabel (Goulart and Chen 2024).
"""

from __future__ import annotations

import math
from importlib import import_module
from itertools import product
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse

from benchmarks.regions.parameters import Bounds
from benchmarks.verify_region import I, sample
from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.model.coordinates import Q_LOAD

ROUNDS_MAX = 12
INITIAL_VERTICES, ADDED_VERTICES_MAX = 2, 2
"""Vertices of each inequality in the first program; largest number of vertices added to it in a round."""
SLOPE_MIN = 1e-7
"""Sum of a symbol's slopes below which the program leaves it out."""
PROMOTED_ENTRIES = 2
"""Entries of the radius that become symbols: the largest, by which f_h follows the spool."""


class Inequality(NamedTuple):
    """Matrix inequality at one K_p."""

    before: FloatArray
    """Weights of the table's matrices in M(K_p), shape (gains,)."""
    after: FloatArray
    """The same in M(K_p+)."""
    center: FloatArray
    """Center of H, shape (n, n + disturbances)."""
    slopes: FloatArray
    """H by each symbol."""

    def vertex(self, number: int) -> FloatArray:
        """Return H at one vertex."""
        return self.center + np.tensordot(_signs(len(self.slopes))[number], self.slopes, 1)


def _signs(symbols: int) -> FloatArray:
    """Vertices of a cube, shape (2^symbols, symbols)."""
    return np.array(list(product((-1.0, 1.0), repeat=symbols)))


def inequalities(region: dict[str, Any], tolerances: dict[str, Bounds], gains: FloatArray) -> list[Inequality]:
    """Return the inequalities at the table's gains and their midpoints, for either side of the spool's zero."""
    found, reach, n = [], region["gain_rate"] * SAMPLE_PERIOD, len(region["scale"])
    columns = [*range(n), *(n + i for i in np.flatnonzero(region["weights"]))]

    def shares(gain: float) -> FloatArray:
        return np.array([np.interp(gain, gains, hat) for hat in np.eye(len(gains))])

    for gain in (*gains, *(0.5 * (gains[1:] + gains[:-1]))):
        for side in (1, -1):
            made = sample(region, tolerances, side, I(gain)).cut(range(n), columns)
            slopes = [one for one in made.s[1:] if np.abs(one).sum() > SLOPE_MIN]
            for place in np.argsort(made.r[:, :n], axis=None)[::-1][:PROMOTED_ENTRIES]:
                at = divmod(int(place), n)
                slopes.append(np.zeros_like(made.r))
                slopes[-1][at] = made.r[at]
            for change in (reach, -reach) if reach else (0.0,):
                found.append(Inequality(shares(gain), shares(gain + change), made.s[0], np.array(slopes)))
    return found


def solve_metric(
    region: dict[str, Any], tolerances: dict[str, Bounds], gains: FloatArray, margin: float
) -> FloatArray | None:
    """Return the matrices of a part of the tolerances, shape (gains, n, n); None: infeasible.

    `margin`: on the rate [1/s], for the radius that the vertices leave out.
    """
    todo, rng, matrices = inequalities(region, tolerances, gains), np.random.default_rng(0), None
    active = [
        (i, int(v))
        for i, one in enumerate(todo)
        for v in rng.choice(2 ** len(one.slopes), INITIAL_VERTICES, replace=False)
    ]
    for _ in range(ROUNDS_MAX):
        matrices = _solve(region, todo, active, len(gains), margin)
        if matrices is None:
            return None
        added = []
        for i, one in enumerate(todo):
            left = _margins(region, matrices, one)
            worst = [(i, int(v)) for v in np.argsort(left)[:ADDED_VERTICES_MAX] if left[v] < 0.0]
            added += [place for place in worst if place not in active]
        if not added:
            break
        active += added
    return matrices


def _level(region: dict[str, Any]) -> tuple[float, FloatArray]:
    """Return exp(-2 lambda T), and the disturbances' weights in the right side."""
    decay = math.exp(-2.0 * region["tube_rate"] * SAMPLE_PERIOD)
    return decay, np.array([(1.0 - decay) * weight for weight in region["weights"] if weight > 0.0])


def _margins(region: dict[str, Any], matrices: FloatArray, one: Inequality) -> FloatArray:
    """Return 1 - ||M+^1/2 H B^-1/2|| at every vertex, B the right side; negative: violated."""
    before, after = (np.tensordot(weights, matrices, 1) for weights in (one.before, one.after))
    decay, weights = _level(region)
    bound = np.diag([*np.zeros(len(before)), *weights])
    bound[: len(before), : len(before)] = decay * before
    left, right = np.linalg.cholesky(after).T, np.linalg.inv(np.linalg.cholesky(bound).T)
    whole = left @ (one.center @ right + np.tensordot(_signs(len(one.slopes)), one.slopes @ right, 1))
    return 1.0 - np.sqrt(np.linalg.eigvalsh(whole.transpose(0, 2, 1) @ whole)[:, -1])


def _triangle(width: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]:
    """Rows and columns of an upper triangle by columns, and the factors of its entries in Clarabel's vectors."""
    column, row = np.tril_indices(width)
    return row, column, np.where(row == column, 1.0, math.sqrt(2.0))


def _solve(
    region: dict[str, Any], todo: list[Inequality], active: list[tuple[int, int]], nodes: int, margin: float
) -> FloatArray | None:
    """Matrices of the program with the active vertices, shape (nodes, n, n); None: it has no solution."""
    clarabel = import_module("clarabel")  # of requirements-bench.txt: a statement is read without it
    n, (decay, weights) = len(region["scale"]), _level(region)
    width = n + len(weights)
    row, column, root = _triangle(n)
    r, c, factors = _triangle(width)
    units = np.zeros((len(row), n, n))
    units[np.arange(len(row)), row, column] = units[np.arange(len(row)), column, row] = 1.0
    held = np.zeros((len(row), width, width))
    held[:, :n, :n] = decay * math.exp(-2.0 * margin * SAMPLE_PERIOD) * units
    own = held[:, r, c].T * factors[:, None]
    level = np.diag([*np.zeros(n), *weights])
    blocks, sides, cones = [], [], []
    for i, vertex in active:
        one, h = todo[i], todo[i].vertex(vertex)
        moved = (h.T @ units @ h)[:, r, c].T * factors[:, None]
        terms = [sparse.csc_matrix(a * moved - b * own) for b, a in zip(one.before, one.after, strict=True)]
        blocks.append(sparse.hstack([*terms, sparse.csc_matrix((len(r), 1))]))
        sides.append(level[r, c] * factors)
        cones.append(clarabel.PSDTriangleConeT(width))
    along = sparse.csc_matrix(((row == Q_LOAD) & (column == Q_LOAD)).astype(float)[:, None])
    for node in range(nodes):
        places = sparse.csc_matrix(np.eye(nodes)[node])
        blocks.append(sparse.hstack([-sparse.kron(places, sparse.diags(root)), along]))
        sides.append(np.zeros(len(row)))
        cones.append(clarabel.PSDTriangleConeT(n))
    goal = np.zeros(nodes * len(row) + 1)
    goal[-1] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose, settings.max_threads = False, 1
    none = sparse.csc_matrix((len(goal), len(goal)))
    constraints = sparse.csc_matrix(sparse.vstack(blocks))
    solution = clarabel.DefaultSolver(none, goal, constraints, np.concatenate(sides), cones, settings).solve()
    found = np.array(solution.x)
    matrices = np.tensordot(found[:-1].reshape(nodes, len(row)), units, 1)
    if "Solved" not in str(solution.status) or found[-1] <= 0.0 or np.linalg.eigvalsh(matrices).min() <= 0.0:
        return None
    return np.asarray(matrices, np.float64)
