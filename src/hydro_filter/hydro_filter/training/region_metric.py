# SPDX-License-Identifier: Apache-2.0
"""Metric of a region by semidefinite programming, with constraints at vertices that are added in rounds.

Largest t with M(K_p) >= t e e' for all K_p, e along f_l, under the inequality of `region.proof`: t = (f/tube)^2 for the
force's unit f, so that the tube is the smallest that a quadratic form can prove. A program of some vertices is solved,
those that its solution violates most are added, and so on. Solved by Clarabel (Goulart and Chen 2024).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import sparse

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.model.coordinates import Q_LOAD
from hydro_filter.region.certified_region import Bounds, CertifiedRegion, ToleranceCell
from hydro_filter.region.enclosure import enclose_closed_loop
from hydro_filter.region.interval import AffineSet, Interval
from hydro_filter.region.proof import decay_margin, reduce_symbols

ROUNDS_MAX = 12
INITIAL_VERTICES, ADDED_VERTICES_MAX = 2, 2
"""Vertices of each inequality in the first program; largest number of vertices added to it in a round."""


class Inequality(NamedTuple):
    """Matrix inequality at one K_p: interpolation weights of M and M+ in the table, and the set of H."""

    before: FloatArray
    after: FloatArray
    sample: AffineSet
    signs: FloatArray


def make_inequalities(region: CertifiedRegion, tolerances: dict[str, Bounds], gains: FloatArray) -> list[Inequality]:
    """Return the inequalities at the table's gains and their midpoints, for either side of the spool's zero."""
    found, reach = [], region.gain_rate * SAMPLE_PERIOD

    def shares(gain: float) -> FloatArray:
        return np.array([np.interp(gain, gains, hat) for hat in np.eye(len(gains))])

    for gain in (*gains, *(0.5 * (gains[1:] + gains[:-1]))):
        for side in (1, -1):
            sample, signs = reduce_symbols(
                enclose_closed_loop(region, tolerances, side, Interval(float(gain), float(gain)))
            )
            sample = replace(sample, radius=0.0 * sample.radius)  # the reserve covers it
            for change in (reach, -reach) if reach else (0.0,):
                found.append(Inequality(shares(gain), shares(gain + change), sample, signs))
    return found


def solve_cell(
    region: CertifiedRegion, tolerances: dict[str, Bounds], gains: FloatArray, reserve: float
) -> ToleranceCell | None:
    """Solve the metric of a part of the tolerances; None: infeasible.

    `reserve`: margin [1/s] on the rate, for the radius that the vertices leave out. The proof is
    `region.proof.prove_cell`'s.
    """
    todo, rng = make_inequalities(region, tolerances, gains), np.random.default_rng(0)
    active = [
        (i, int(v)) for i, one in enumerate(todo) for v in rng.choice(len(one.signs), INITIAL_VERTICES, replace=False)
    ]
    cell = None
    for _ in range(ROUNDS_MAX):
        matrices = _solve(region, todo, active, len(gains), reserve)
        if matrices is None:
            return None
        cell = ToleranceCell(tolerances=tolerances, gains=tuple(float(gain) for gain in gains), matrices=matrices)
        added = []
        for i, one in enumerate(todo):
            before, after = (np.asarray(np.tensordot(s, matrices, 1), np.float64) for s in (one.before, one.after))
            left = decay_margin(region, (before, after), one.sample, one.signs)
            worst = [(i, int(v)) for v in np.argsort(left)[:ADDED_VERTICES_MAX] if left[v] < 0.0]
            added += [place for place in worst if place not in active]
        if not added:
            break
        active += added
    return cell


def _triangle(width: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp], FloatArray]:
    """Rows and columns of an upper triangle by columns, and the factors of its entries in Clarabel's vectors."""
    column, row = np.tril_indices(width)
    return row, column, np.where(row == column, 1.0, math.sqrt(2.0))


def _solve(
    region: CertifiedRegion, todo: list[Inequality], active: list[tuple[int, int]], nodes: int, reserve: float
) -> FloatArray | None:
    """Matrices of the program with the active vertices, shape (nodes, n, n); None: it has no solution."""
    import clarabel

    n, used, rate = region.coordinates, region.directions, region.decay
    width, columns = n + len(used), [*range(n), *(n + i for i in used)]
    row, column, root = _triangle(n)
    r, c, factors = _triangle(width)
    units = np.zeros((len(row), n, n))
    units[np.arange(len(row)), row, column] = units[np.arange(len(row)), column, row] = 1.0
    held = np.zeros((len(row), width, width))
    held[:, :n, :n] = rate * math.exp(-2.0 * reserve * SAMPLE_PERIOD) * units
    own = held[:, r, c].T * factors[:, None]
    level = np.zeros((width, width))
    level[n:, n:] = np.diag([(1.0 - rate) * region.weights[i] for i in used])
    blocks, sides, cones = [], [], []
    for i, vertex in active:
        one = todo[i]
        h = (one.sample.center + np.tensordot(one.signs[vertex], one.sample.slopes, 1))[:, columns]
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
