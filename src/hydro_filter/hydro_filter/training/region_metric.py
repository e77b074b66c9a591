# SPDX-License-Identifier: Apache-2.0
"""Metric of a region: the semidefinite program whose constraints are the vertices that matter, found one by one.

Largest t with M(K_p) >= t e e' for all K_p, e along f_l, under the inequality of `region.proof`: t = (f/tube)^2 for the
force's unit f, so the tube is the smallest that a quadratic form can prove. Solved by Clarabel (Goulart and Chen 2024).
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.model.coordinates import Q_LOAD
from hydro_filter.region.enclosure import coordinates, loop
from hydro_filter.region.interval import Affine, Interval
from hydro_filter.region.proof import reduced, room
from hydro_filter.region.statement import Cell, Pair, Statement


class Ask(NamedTuple):
    """The inequality at one K_p: shares of the table's matrices in M and M+, and the set of H."""

    before: FloatArray
    after: FloatArray
    sample: Affine
    signs: FloatArray


def asks(of: Statement, tolerances: dict[str, Pair], gains: FloatArray) -> list[Ask]:
    """Inequalities at the table's gains and between them."""
    found, reach = [], of.gain_rate * SAMPLE_PERIOD
    middle = 0.5 * (gains[1:] + gains[:-1])
    eye = np.eye(len(gains))

    def shares(gain: float) -> FloatArray:
        return np.array([np.interp(gain, gains, row) for row in eye])

    for gain in (*gains, *middle):
        for side in (1, -1):
            sample, signs = reduced(loop(of, tolerances, side, Interval(float(gain), float(gain))))
            sample = replace(sample, radius=0.0 * sample.radius)  # it is the reserve's
            for change in (reach, -reach) if reach else (0.0,):
                found.append(Ask(shares(gain), shares(gain + change), sample, signs))
    return found


def solve_cell(
    of: Statement, tolerances: dict[str, Pair], gains: FloatArray, reserve: float = 0.0, rounds: int = 12, verbose=False
) -> tuple[Cell | None, float]:
    """Return the metric of a part of the tolerances, and its tube [N]; None: there is none.

    `reserve`: 1/s on top of lambda for what is not in the vertices.
    """
    todo, n = asks(of, tolerances, gains), coordinates(of)
    rng = np.random.default_rng(0)
    active = [
        (i, int(v))
        for i, ask in enumerate(todo)
        for v in rng.choice(len(ask.signs), min(2, len(ask.signs)), replace=False)
    ]
    for turn in range(rounds):
        matrices, tube, status = _program(of, todo, active, len(gains), n, reserve)
        if verbose:
            print(turn, len(active), status, tube, flush=True)
        if matrices is None:
            return None, math.inf
        cell = Cell(tolerances=tolerances, gains=tuple(float(g) for g in gains), matrices=matrices)
        new = []
        worst = np.inf
        for i, ask in enumerate(todo):
            pair = np.tensordot(ask.before, matrices, 1), np.tensordot(ask.after, matrices, 1)
            left = room(of, pair, ask.sample, ask.signs)
            worst = min(worst, left.min())
            bad = np.argsort(left)[:2]
            new += [(i, int(v)) for v in bad if left[v] < 0.0 and (i, int(v)) not in active]
        if verbose:
            print("   worst", worst, len(new), flush=True)
        if worst >= 0.0 or not new:  # the solver's accuracy; the proof judges
            return cell, tube
        active += new
    return cell, tube


def _program(of, todo, active, nodes, n, reserve):
    import clarabel

    row, column = np.tril_indices(n)
    row, column = column, row  # upper triangle by columns
    order = np.lexsort((row, column))
    row, column = row[order], column[order]
    size = len(row)
    units = np.zeros((size, n, n))
    units[np.arange(size), row, column] = units[np.arange(size), column, row] = 1.0
    used = [i for i, weight in enumerate(of.weights) if weight > 0.0]
    whole = n + len(used)
    r, c = np.tril_indices(whole)
    r, c = c, r
    order = np.lexsort((r, c))
    r, c = r[order], c[order]
    root = np.where(r == c, 1.0, math.sqrt(2.0))
    own_root = np.where(row == column, 1.0, math.sqrt(2.0))
    decay = math.exp(-2.0 * (of.tube_rate + reserve) * SAMPLE_PERIOD)
    plain = math.exp(-2.0 * of.tube_rate * SAMPLE_PERIOD)
    columns = [*range(n), *(n + i for i in used)]
    level = np.zeros((whole, whole))
    level[n:, n:] = np.diag([(1.0 - plain) * of.weights[i] for i in used])
    padded = np.zeros((size, whole, whole))
    padded[:, :n, :n] = decay * units
    own = (padded[:, r, c] * root).T
    blocks, sides, cones = [], [], []
    for i, vertex in active:
        ask = todo[i]
        h = (ask.sample.center + np.tensordot(ask.signs[vertex], ask.sample.slopes, 1))[:, columns]
        moved = h.T @ units @ h
        moved = (moved[:, r, c] * root).T
        parts = [sparse.csc_matrix((len(r), size))] * nodes
        for node in range(nodes):
            if ask.before[node] or ask.after[node]:
                parts[node] = sparse.csc_matrix(ask.after[node] * moved - ask.before[node] * own)
        blocks.append(sparse.hstack([*parts, sparse.csc_matrix((len(r), 1))]))
        sides.append(level[r, c] * root)
        cones.append(clarabel.PSDTriangleConeT(whole))
    along = np.zeros((size, 1))
    along[(row == Q_LOAD) & (column == Q_LOAD)] = 1.0
    for node in range(nodes):
        parts = [sparse.csc_matrix((size, size))] * nodes
        parts[node] = -sparse.diags(own_root)
        blocks.append(sparse.hstack([*parts, sparse.csc_matrix(along)]))
        sides.append(np.zeros(size))
        cones.append(clarabel.PSDTriangleConeT(n))
    goal = np.zeros(nodes * size + 1)
    goal[-1] = -1.0
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    solver = clarabel.DefaultSolver(
        sparse.csc_matrix((len(goal), len(goal))),
        goal,
        sparse.csc_matrix(sparse.vstack(blocks)),
        np.concatenate(sides),
        cones,
        settings,
    )
    solution = solver.solve()
    x = np.array(solution.x)
    if "Solved" not in str(solution.status):
        return None, math.inf, str(solution.status)
    matrices = np.tensordot(x[:-1].reshape(nodes, size), units, 1)
    if x[-1] <= 0.0 or np.linalg.eigvalsh(matrices).min() <= 0.0:
        return None, math.inf, str(solution.status)
    return matrices, of.scale[Q_LOAD] / math.sqrt(x[-1]), str(solution.status)
