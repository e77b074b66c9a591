# SPDX-License-Identifier: Apache-2.0
"""Screen of all laws: what each gains on held-out blocks beside a fit, to first order, at once.

The responses of all laws, at every start value of their further numbers, are computed once. Beside any fit, products
with its residual and its columns give four-fold cross-validation (`evidence`) of each law alone in closed form. Only
the best few are fitted.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from copy import copy
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from hydro_diagnosis.closure.column_gains import column_gains
from hydro_diagnosis.closure.evidence import SHORTEST
from hydro_diagnosis.closure.folded import FoldedResponses
from hydro_diagnosis.closure.responses import Responses, shown
from hydro_diagnosis.effects.base import Claim, Effect, FloatArray
from hydro_diagnosis.estimation.fit import Fit, spreads
from hydro_diagnosis.estimation.problem import Problem

CHANCE = 20.0
"""Deviance on held-out blocks that a single column must gain, as the search asks of a cause."""


def threshold(columns: int) -> float:
    """Deviance that the best of so many columns must gain: chance alone reaches 2 ln(columns)."""
    return CHANCE + 2.0 * float(np.log(max(columns, 1)))


@dataclass(frozen=True)
class Prospect:
    """A law that may join a fit."""

    gain: float
    """Held-out deviance that it gains, to first order."""
    starts: tuple[Claim, ...]
    """Values to fit it from, the best first."""

    @property
    def effect(self) -> Effect:
        """The law."""
        return self.starts[0].effect


class Screen:
    """All laws over the recordings of a problem.

    Parameters
    ----------
    problem
        The least-squares problem.
    base
        Names that stand.
    terms
        Laws at start values, those of a law one after the other; without amplitude.
    """

    def __init__(self, problem: Problem, base: Fit, terms: Sequence[Claim]) -> None:
        self.problem, self.terms = problem, list(terms)
        self._laws: list[slice] = []
        """Places of each law's terms."""
        self._responses = FoldedResponses(problem.layout, len(self.terms))
        everything = (*problem.baseline, *base.claims)
        ways = [Responses(problem, model, everything) for model in problem.models]
        at = 0
        for _, same in groupby(self.terms, key=lambda one: one.effect.label):
            probes = [_probed(one) for one in same]
            self._laws.append(slice(at, at + len(probes)))
            self._responses.add(np.arange(at, at + len(probes)), shown(problem, base, ways, probes))
            at += len(probes)
        self._responses.finish()

    @classmethod
    def beside(cls, problem: Problem, base: Fit, terms: Sequence[Claim]) -> Screen:
        """The screen; an earlier one of these recordings beside the same names if there is one.

        What a law does depends little on the other claims' values: to rank laws, not to fit them, it may be old.
        """
        names = tuple(one.effect.label for one in base.claims if one.effect.named)
        key = problem.doubted, names, tuple((one.effect.label, *one.values.values()) for one in terms)
        known = problem.shelf.get("screen")
        if known is None or known[0] != key:
            known = problem.shelf["screen"] = key, cls(problem, base, terms)
        return known[1].for_problem(problem)

    @classmethod
    def last(cls, problem: Problem) -> Screen | None:
        """The last screen of these recordings, beside whichever names: to choose what is fitted it will do."""
        known = problem.shelf.get("screen")
        return known[1].for_problem(problem) if known else None

    def for_problem(self, problem: Problem) -> Screen:
        """The same responses, with the weights of another problem of these recordings."""
        found = copy(self)
        found.problem = problem
        return found

    def __len__(self) -> int:
        return len(self.terms)

    def prospects(self, found: Fit, count: int, without: Collection[str] = ()) -> tuple[list[Prospect], float]:
        """The laws that gain most beside a fit, their further numbers paid, and what there is to gain at all."""
        gains, there_is = self.gains(found)
        price = float(np.log(len(found.residual)))
        by_law = []
        for at in self._laws:
            effect = self.terms[at.start].effect
            if effect.label in without:
                continue
            order = at.start + np.argsort(-gains[at])
            paid = gains[order[0]] - price * (len(effect.parameters) - 1)
            by_law.append((paid, float(gains[order[0]]), [self.terms[k] for k in order]))
        by_law.sort(key=lambda one: -one[0])
        return [Prospect(gain, _apart(terms)) for _, gain, terms in by_law[:count]], there_is

    def gains(self, found: Fit) -> tuple[FloatArray, float]:
        """Held-out deviance that each term gains beside a fit, shape (terms,), and what there is to gain at all."""
        base = np.column_stack([found.residual, found.jacobian])
        lengths = np.maximum(np.linalg.norm(base, axis=0), SHORTEST)
        base = base / lengths
        responses = self._responses
        weight = 1.0 / spreads(self.problem, found.residual)
        size = float(lengths[0]) ** 2
        products = responses.products(base)
        gains, before = column_gains(*products, responses.square, weight, responses.count, size)
        return gains * responses.every, (before - float(responses.count.sum())) * responses.every


def _probed(claim: Claim) -> Claim:
    sizes = {one.name: one.probes[0] for one in claim.effect.parameters if one.smallest > 0.0}
    return Claim(claim.effect, {**claim.values, **sizes})


def _apart(terms: Sequence[Claim]) -> tuple[Claim, ...]:
    """The best start, and of a law with several further numbers the best with each other value of the first."""
    names = [one.name for one in terms[0].effect.parameters if one.smallest == 0.0]
    if len(names) < 2:
        return tuple(terms[:1])
    found: dict[float, Claim] = {}
    for one in terms:
        found.setdefault(one.values[names[0]], one)
    return tuple(found.values())
