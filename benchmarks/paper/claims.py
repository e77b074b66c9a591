# SPDX-License-Identifier: Apache-2.0
"""What the paper claims, as comparisons of pieces, seed by seed: how many came out as it says, and how many are equal.

The filter meant is the paper's after its three epochs (*paper-short*) where a claim does not say ours.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from benchmarks.paper.store import CASES, Result, Store

Comparisons = Callable[[Store], Iterator[float]]
"""Of each comparison that can be made: above 0 as the paper says, 0 equal to the bit, below 0 the contrary."""


def pieces(store: Store, *names: str) -> Iterator[list[Result]]:
    """For each seed whose pieces are all there: the pieces of these names, `{}` standing for the seed; once without."""
    for seed in range(store.size.seeds if any("{}" in name for name in names) else 1):
        row = [found for name in names if (found := store.kept(name.format(seed))) is not None]
        if len(row) == len(names):
            yield row


def less(name: str, other: str, key: str, *, factor: float = 1.0, at: slice = slice(None)) -> Comparisons:
    """Whether `factor` times a piece's numbers are below another's, entry by entry; a run that was stopped is worst."""

    def compare(store: Store) -> Iterator[float]:
        for row in pieces(store, name, other):
            a, b = (np.nan_to_num(np.atleast_1d(np.array(one[key], float)), nan=1e9)[at] for one in row)
            yield from b - factor * a

    return compare


def each(test: Callable[[Result], bool], *names: str) -> Comparisons:
    """Whether something is so of each piece of these names."""
    return lambda store: (1.0 if test(one) else -1.0 for row in pieces(store, *names) for one in row)


def _bounded(*cases: str, chosen: str = "paper-short", as_paper: bool = True) -> Comparisons:
    return each(lambda one: one["bounded"] is as_paper, *(f"validation-{case}-{chosen}-{{}}" for case in cases))


def _untouched(chosen: str) -> Comparisons:
    return each(lambda one: one["gammas"][0] < 0.05, f"validation-stable-{chosen}-{{}}")


def _converged(store: Store) -> Iterator[float]:
    for short, long in pieces(store, "metric-short-{}", "metric-long-{}"):
        yield 1.1 * long["history"][-1]["loss"] - short["history"][-1]["loss"]


CLAIMS: dict[str, Comparisons] = {
    "The trained model errs over a hundred times less than the analytic one (the paper's network, each state)":
        less("model-squared-{}", "model-analytic", "over_range", factor=100.0),
    "Our model does": less("model-ours", "model-analytic", "over_range", factor=100.0),
    "Training over 70 samples predicts 70 samples better than training on one (each state)":
        less("model-squared-{}", "model-one-step-{}", "over_range"),
    "Three epochs suffice for the metric (loss within a tenth of the long training's)": _converged,
    "The filter leaves a stable controller alone (gamma_1 below 0.05 %)": _untouched("paper-short"),
    "Ours does": _untouched("ours"),
    "Without the filter gains drawn from -40 to 40 are unstable": _bounded("unstable", chosen="none", as_paper=False),
    "Behind the filter they stay bounded": _bounded("unstable"),
    "So they do behind strictly negative gains": _bounded("negative"),
    "So they do behind strictly positive gains": _bounded("positive"),
    "Above K_p = 100 the filter does not suffice": _bounded("high", as_paper=False),
    "Behind ours all four draws of gains stay bounded, those above 100 too": _bounded(*CASES[1:], chosen="ours"),
    "Training on the bench beats training in simulation (I below II, each sine; paper: three of four)":
        less("rmse-default-paper-I-{}", "rmse-default-paper-II-{}", "rmse"),
    "I beats fixed (90, 15) (each sine; paper: three of four)":
        less("rmse-default-paper-I-{}", "rmse-default-III-{}", "rmse"),
    "At 0.5 Hz fixed (90, 15) beats I":
        less("rmse-default-III-{}", "rmse-default-paper-I-{}", "rmse", at=slice(1)),
    "The filter lowers chattering (u') in training": less("chatter-paper-short-{}", "chatter-none-{}", "chatter"),
}  # fmt: skip


def counts(store: Store, comparisons: Comparisons) -> str:
    """`as the paper says of all, so many equal`."""
    found = list(comparisons(store))
    equal = sum(one == 0.0 for one in found)
    told = f"{sum(one > 0.0 for one in found)} of {len(found)}" + (f", {equal} equal" if equal else "")
    return told if found else "not run"
