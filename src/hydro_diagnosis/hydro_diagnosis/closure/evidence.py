# SPDX-License-Identifier: Apache-2.0
"""Evidence of closure terms on held-out blocks of time, by cross-validation.

Residuals are linear in a term's numbers to first order. So four-fold cross-validation of any set of columns needs no
further residual: each fold's products of all columns are summed once, by channel, and every set is solved from them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from hydro_diagnosis.effects.base import Claim, FloatArray
from hydro_diagnosis.estimation.fit import Fit, spreads
from hydro_diagnosis.estimation.intervals import QUANTILE
from hydro_diagnosis.estimation.problem import CHANNELS, Problem

EDGE = 1e-3
"""Share of a number's size or range, within which of a bound it stands there."""
FOLDS = 4
VAGUE = 0.5
"""95 % reach of a law's further number, over its size or its range, from which it says nothing."""
BLOCK = 1.0
"""Length of a held-out block [s]: many times the memory of any residual."""


class HeldOutBlocks:
    """Columns of candidates beside a fit, and how well any set of them predicts blocks that it was not fitted to.

    Parameters
    ----------
    problem
        The least-squares problem.
    found
        The present fit; its parameters are estimated anew with each set.
    columns
        By candidate: derivatives of the residual, shape (n, numbers).
    """

    def __init__(self, problem: Problem, found: Fit, columns: Sequence[FloatArray]) -> None:
        layout = problem.layout
        table = np.column_stack([found.residual, found.jacobian, *columns])
        self._scale = np.maximum(np.linalg.norm(table, axis=0), 1e-300)
        table /= self._scale
        edges = np.cumsum([1, found.jacobian.shape[1], *(one.shape[1] for one in columns)])
        self._standing = list(range(1, int(edges[1])))
        self._places = [list(range(int(a), int(b))) for a, b in pairwise(edges[1:])]
        fold = (np.floor(layout.time / BLOCK).astype(np.int64) + layout.segment) % FOLDS
        weight = 1.0 / spreads(problem, found.residual)
        self._products = np.zeros((FOLDS, len(CHANNELS), table.shape[1], table.shape[1]))
        for k in range(FOLDS):
            for channel in np.unique(layout.channel):
                part = table[(fold == k) & (layout.channel == channel)]
                self._products[k, channel] = part.T @ part
        self._weighted = np.einsum("fcij,c->fij", self._products, weight)
        self._count = layout.count()

    def deviance(self, chosen: Sequence[int]) -> float:
        """-2 log likelihood of the held-out blocks with these candidates, up to a constant."""
        at = [*self._standing, *(place for one in chosen for place in self._places[one])]
        squares, together = np.zeros(len(CHANNELS)), self._weighted.sum(axis=0)
        for k in range(FOLDS):
            fitted = together - self._weighted[k]
            theta = -np.linalg.lstsq(fitted[np.ix_(at, at)], fitted[at, 0], rcond=1e-10)[0] if at else np.zeros(0)
            full = np.concatenate([[1.0], theta])
            rows = [0, *at]
            squares += np.einsum("i,cij,j->c", full, self._products[k][np.ix_(range(len(CHANNELS)), rows, rows)], full)
        squares *= self._scale[0] ** 2
        variance = np.maximum(squares / np.maximum(self._count, 1.0), 1.0)
        return float(np.sum(self._count * np.log(variance) + squares / variance))


def definite(problem: Problem, found: Fit, claim: Claim) -> bool:
    """Return whether each further number of a law is known, and off its bounds.

    Where one is not, the law is another in disguise: friction that warms over an endless path is dry friction.
    """
    weight = 1.0 / spreads(problem, found.residual)[problem.layout.channel]
    normal = found.jacobian.T @ (found.jacobian * weight[:, None])
    deviations = np.sqrt(np.maximum(np.diag(np.linalg.pinv(normal, hermitian=True)), 0.0))
    at = sum(len(one.effect.parameters) for one in found.claims[: found.claims.index(claim)])
    for one, deviation in zip(claim.effect.parameters, deviations[at:], strict=False):
        value, width = claim.values[one.name], one.high - one.low
        size = abs(value) if one.low > 0.0 else width
        inside = one.low + EDGE * min(size, width) < value < one.high - EDGE * min(size, width)
        if one.smallest == 0.0 and not (inside and QUANTILE * deviation * one.span < VAGUE * size):
            return False
    return True
