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
from hydro_diagnosis.estimation.layout import CHANNELS
from hydro_diagnosis.estimation.problem import Problem

EDGE = 1e-3
"""Share of a number's size or range, within which of a bound it stands there."""
FOLDS = 4
SHORTEST = 1e-100
"""Length of a column below which it counts as nothing: its square still is a number."""
UNSEEN = 1e-14
"""Share of the largest information of any number, below which one is not seen at all."""
VAGUE = 0.5
"""95 % reach of a law's further number, over its size or its range, from which it says nothing."""
BLOCK = 1.0
"""Length of a held-out block [s]: many times the memory of any residual."""


class Blocks:
    """Residuals in folds of blocks of time, by channel."""

    def __init__(self, problem: Problem) -> None:
        layout = problem.layout
        fold = (np.floor(layout.time / BLOCK).astype(np.int64) + layout.segment) % FOLDS
        self._order = np.lexsort((fold, layout.channel))
        group = (layout.channel * FOLDS + fold)[self._order]
        self._edges = np.searchsorted(group, np.arange(len(CHANNELS) * FOLDS + 1))

    def sorted(self, columns: FloatArray) -> FloatArray:
        """Rows of an array, shape (n, columns), by channel and fold."""
        return columns[self._order]

    def products(self, one: FloatArray, other: FloatArray) -> FloatArray:
        """Products of columns by fold and channel; shape (folds, channels, columns of one, columns of the other)."""
        found = np.zeros((FOLDS, len(CHANNELS), one.shape[1], other.shape[1]))
        for at, (begin, end) in enumerate(pairwise(self._edges)):
            found[at % FOLDS, at // FOLDS] = one[begin:end].T @ other[begin:end]
        return found


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
        blocks, standing = Blocks(problem), np.column_stack([found.residual, found.jacobian])
        table = [blocks.sorted(one) for one in (standing, *columns)]
        self._take(problem, found, [[blocks.products(one, other) for other in table] for one in table])

    @classmethod
    def of_products(cls, problem: Problem, found: Fit, products: Sequence[Sequence[FloatArray]]) -> HeldOutBlocks:
        """The same from `Blocks.products` of residual and Jacobian, together, and of the candidates with each other."""
        made = cls.__new__(cls)
        made._take(problem, found, products)
        return made

    def _take(self, problem: Problem, found: Fit, products: Sequence[Sequence[FloatArray]]) -> None:
        edges = np.cumsum([one[0].shape[-2] for one in products])
        self._standing = list(range(1, int(edges[0])))
        self._places = [list(range(int(a), int(b))) for a, b in pairwise(edges)]
        self._products = np.concatenate([np.concatenate(row, axis=-1) for row in products], axis=-2)
        squares = np.einsum("fcii->i", self._products)
        self._scale = np.maximum(np.sqrt(np.maximum(squares, 0.0)), SHORTEST)
        self._products /= self._scale[:, None] * self._scale
        weight = 1.0 / spreads(problem, found.residual)
        self._weighted = np.einsum("fcij,c->fij", self._products, weight)
        self._count = problem.layout.count()

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
    deviations[np.diag(normal) <= UNSEEN * np.max(np.diag(normal), initial=0.0)] = np.inf  # the pseudo-inverse has 0
    at = sum(len(one.effect.parameters) for one in found.claims[: found.claims.index(claim)])
    for one, deviation in zip(claim.effect.parameters, deviations[at:], strict=False):
        value, width = claim.values[one.name], one.high - one.low
        size = abs(value) if one.low > 0.0 else width
        inside = one.low + EDGE * min(size, width) < value < one.high - EDGE * min(size, width)
        if one.smallest == 0.0 and not (inside and QUANTILE * deviation * one.span < VAGUE * size):
            return False
    return True
