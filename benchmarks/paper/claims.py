# SPDX-License-Identifier: Apache-2.0
"""What the paper claims, judged by the pieces that are there.

A claim is a share of comparisons that came out as the paper says, over seeds and conditions: all of them: it holds;
none: it does not hold here; else: in part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from benchmarks.paper.store import Result, Store

NOT_RUN = "not run yet"


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper."""

    text: str
    comparisons: Callable[[Store], list[bool]]
    """One entry for each comparison whose pieces are there."""

    def verdict(self, store: Store) -> tuple[str, int, int]:
        """In words, how many comparisons came out as the paper says, and how many there are."""
        found = self.comparisons(store)
        return judged(found), sum(found), len(found)


def judged(found: Sequence[bool]) -> str:
    """The words for comparisons."""
    if not found:
        return NOT_RUN
    return "holds" if all(found) else "holds in part" if any(found) else "does not hold here"


def pieces(store: Store, *names: str) -> list[list[Result]]:
    """For each seed whose pieces are all there: the pieces of these names, `{}` in a name standing for the seed."""
    rows = [[store.kept(name.format(seed)) for name in names] for seed in range(store.size.seeds)]
    return [[one for one in row if one is not None] for row in rows if all(one is not None for one in row)]


def _each(name: str, other: str, key: str, better: Callable[[Any, Any], Any]) -> Callable[[Store], list[bool]]:
    """Entry by entry of a list in two pieces."""

    def compare(store: Store) -> list[bool]:
        pairs = pieces(store, name, other)
        return [bool(one) for a, b in pairs for one in better(np.array(a[key], float), np.array(b[key], float))]

    return compare


def _less(a: Any, b: Any) -> Any:
    return a < b


def _hundredth(a: Any, b: Any) -> Any:
    return 100.0 * a < b


def _bounded(case: str, filtered: str) -> Callable[[Store], list[bool]]:
    """Whether each run stays bounded behind a filter."""

    def compare(store: Store) -> list[bool]:
        found = store.kept(f"validation-{case}-{filtered}")
        return [] if found is None else [k < found["bounded"] for k in range(found["runs"])]

    return compare


def _untouched(store: Store) -> list[bool]:
    found = store.kept("validation-stable-paper-short")
    return [] if found is None else [row[0] < 0.05 for row in found["gammas"]]


def _slow_sine(store: Store) -> list[bool]:
    found = pieces(store, "rmse-default-paper-I-{}", "rmse-default-III-{}")
    return [first["rmse"][0] > third["rmse"][0] for first, third in found]


CLAIMS = (
    Claim(
        "The trained model errs more than a hundred times less than the analytic one (the paper's network, all states)",
        _each("model-squared-{}", "model-analytic", "over_range", _hundredth),
    ),
    Claim(
        "The same of our model",
        _each("model-ours", "model-analytic", "over_range", _hundredth),
    ),
    Claim(
        "Training over 70 samples predicts 70 samples better than training on one (all states)",
        _each("model-squared-{}", "model-one-step-{}", "over_range", _less),
    ),
    Claim("The filter leaves a stable controller alone (gamma_1 below 0.05 %)", _untouched),
    Claim("Behind the filter gains drawn from -40 to 40 stay bounded", _bounded("unstable", "paper-short")),
    Claim("So they do behind strictly negative gains", _bounded("negative", "paper-short")),
    Claim("So they do behind strictly positive gains", _bounded("positive", "paper-short")),
    Claim(
        "Above K_p = 100 the filter does not suffice",
        lambda store: [not one for one in _bounded("high", "paper-short")(store)],
    ),
    Claim(
        "Training on the bench beats training in simulation (I below II, each sine; paper: three of four)",
        _each("rmse-default-paper-I-{}", "rmse-default-paper-II-{}", "rmse", _less),
    ),
    Claim(
        "The same on the bench outside of the model's physics",
        _each("rmse-outside-paper-I-{}", "rmse-outside-paper-II-{}", "rmse", _less),
    ),
    Claim(
        "I beats fixed (90, 15) (each sine; paper: three of four)",
        _each("rmse-default-paper-I-{}", "rmse-default-III-{}", "rmse", _less),
    ),
    Claim(
        "The same on the bench outside of the model's physics",
        _each("rmse-outside-paper-I-{}", "rmse-outside-III-{}", "rmse", _less),
    ),
    Claim("At 0.5 Hz fixed (90, 15) beats I", _slow_sine),
    Claim(
        "The filter lowers chattering (u') in training",
        lambda store: [
            with_["chatter"] < without["chatter"]
            for with_, without in pieces(store, "chatter-paper-long-{}", "chatter-none-{}")
        ],
    ),
)
