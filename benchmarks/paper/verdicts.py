# SPDX-License-Identifier: Apache-2.0
"""How a claim of the paper is judged: comparisons of pieces, seed by seed, and the words for what they come to.

A claim is a share of comparisons that came out as the paper says, over seeds and conditions: all of them: it holds;
some: in part; none: it does not hold here; or no difference, where all are equal to the bit.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper.store import Result, Store
from hydro_bridge.signals import FloatArray

NOT_RUN = "not run yet"
AS_PAPER, EQUAL, CONTRARY = 1, 0, -1
Outcome = int
"""Of a comparison: one of the three."""
Comparisons = Callable[[Store], list[list[Outcome]]]
"""Outcomes of each seed whose pieces are there; one list of a claim without seeds."""


@dataclass(frozen=True)
class Verdict:
    """What the comparisons come to."""

    as_paper: int
    equal: int
    count: int
    seeds: int
    """Seeds that were run; 0 of a claim without."""

    @property
    def words(self) -> str:
        """In words."""
        if not self.count:
            return NOT_RUN
        if self.as_paper:
            return "holds" if self.as_paper == self.count else "holds in part"
        return "no difference" if self.equal == self.count else "does not hold here"

    def cell(self, planned: int, *, judged: bool = True) -> str:
        """With its counts; `planned`: seeds of the size; not `judged`: the counts alone."""
        if not self.count:
            return NOT_RUN
        told = f"{self.as_paper} of {self.count}" + (f", {self.equal} equal" if self.equal else "")
        missing = f"; {self.seeds} of {planned} seeds" if 0 < self.seeds < planned else ""
        return f"{self.words} ({told}{missing})" if judged else told + missing


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper."""

    key: str
    """In `reasons`."""
    text: str
    comparisons: Comparisons
    seeds: bool = True
    """Whether there is a comparison for each seed."""

    def verdict(self, store: Store) -> Verdict:
        """By the pieces that are there."""
        found = self.comparisons(store)
        return verdict(found, seeds=self.seeds)


def verdict(found: Sequence[Sequence[Outcome]], *, seeds: bool = True) -> Verdict:
    """Of outcomes, seed by seed."""
    each = [one for row in found for one in row]
    return Verdict(each.count(AS_PAPER), each.count(EQUAL), len(each), len(found) if seeds else 0)


def pieces(store: Store, *names: str) -> list[list[Result]]:
    """For each seed whose pieces are all there: the pieces of these names, `{}` standing for the seed; once without."""
    seeds = store.size.seeds if any("{}" in name for name in names) else 1
    rows = [[store.kept(name.format(seed)) for name in names] for seed in range(seeds)]
    return [[one for one in row if one is not None] for row in rows if all(one is not None for one in row)]


def less(name: str, other: str, key: str, *, factor: float = 1.0, at: slice = slice(None)) -> Comparisons:
    """Whether `factor` times a piece's numbers are below another's, entry by entry; a run that was stopped is worst."""

    def compare(store: Store) -> list[list[Outcome]]:
        pairs = [(factor * numbers(a[key])[at], numbers(b[key])[at]) for a, b in pieces(store, name, other)]
        return [[EQUAL if x == y else outcome(x < y) for x, y in zip(a, b, strict=True)] for a, b in pairs]

    return compare


def numbers(value: Any) -> FloatArray:
    """Of a piece, one or many; infinite where a run was stopped."""
    return np.nan_to_num(np.atleast_1d(np.array(value, float)), nan=np.inf, posinf=np.inf)


def table(store: Store, name: str, key: str) -> FloatArray:
    """A number or numbers of a piece, a row for each seed that is there, shape (seeds, n)."""
    return np.array([numbers(found[key]) for (found,) in pieces(store, name)])


def bounded(case: str, chosen: str, *, as_paper: bool = True) -> Comparisons:
    """Whether each run of Table val_cont stays bounded, or with `as_paper` False whether it does not."""

    def look(store: Store) -> list[list[Outcome]]:
        return [[outcome(one["bounded"] is as_paper)] for (one,) in pieces(store, f"validation-{case}-{chosen}-{{}}")]

    return look


def outcome(as_paper: bool) -> Outcome:
    """Of a comparison in which nothing can be equal."""
    return AS_PAPER if as_paper else CONTRARY
