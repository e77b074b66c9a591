# SPDX-License-Identifier: Apache-2.0
"""What the paper claims, judged by the pieces that are there.

A claim is a share of comparisons that came out as the paper says, over seeds and conditions: all of them: it holds;
none: it does not hold here; else: in part. Why, in words, stands in reasons.yaml, for the verdict that it explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from benchmarks.paper.store import Result, Store
from hydro_bridge.signals import FloatArray

NOT_RUN = "not run yet"

REASONS: Mapping[str, Mapping[str, str]] = yaml.safe_load(
    (Path(__file__).parent / "reasons.yaml").read_text(encoding="utf-8")
)
"""reasons.yaml: by claim, then by `size, verdict`."""


@dataclass(frozen=True)
class Claim:
    """One sentence of the paper."""

    key: str
    """In reasons.yaml."""
    text: str
    comparisons: Callable[[Store], list[bool]]
    """One entry for each comparison whose pieces are there."""

    def verdict(self, store: Store) -> tuple[str, int, int]:
        """In words, how many comparisons came out as the paper says, and how many there are."""
        found = self.comparisons(store)
        return judged(found), sum(found), len(found)

    def reason(self, store: Store) -> str:
        """Why; empty if nobody has said why of this verdict at this size."""
        return REASONS.get(self.key, {}).get(f"{store.size.name}, {self.verdict(store)[0]}", "")


def judged(found: Sequence[bool]) -> str:
    """The words for comparisons."""
    if not found:
        return NOT_RUN
    return "holds" if all(found) else "holds in part" if any(found) else "does not hold here"


def pieces(store: Store, *names: str) -> list[list[Result]]:
    """For each seed whose pieces are all there: the pieces of these names, `{}` standing for the seed; once without."""
    seeds = store.size.seeds if any("{}" in name for name in names) else 1
    rows = [[store.kept(name.format(seed)) for name in names] for seed in range(seeds)]
    return [[one for one in row if one is not None] for row in rows if all(one is not None for one in row)]


def less(name: str, other: str, key: str, *, factor: float = 1.0, at: slice = slice(None)) -> Callable[..., list[bool]]:
    """Whether `factor` times a piece's numbers are below another's, entry by entry; a run that was stopped is worst."""

    def compare(store: Store) -> list[bool]:
        pairs = [(_numbers(a[key])[at], _numbers(b[key])[at]) for a, b in pieces(store, name, other)]
        return [bool(one) for a, b in pairs for one in factor * a < b]

    return compare


def _numbers(value: Any) -> FloatArray:
    return np.nan_to_num(np.atleast_1d(np.array(value, float)), nan=np.inf, posinf=np.inf)


def bounded(case: str, chosen: str, *, as_paper: bool = True) -> Callable[..., list[bool]]:
    """Whether each run of Table val_cont stays bounded, or with `as_paper` False whether it does not."""

    def look(store: Store) -> list[bool]:
        found = store.kept(f"validation-{case}-{chosen}")
        return [] if found is None else [one is as_paper for one in found["bounded"]]

    return look


def untouched(store: Store) -> list[bool]:
    """Whether gamma_1 of each stable run is 0 as far as the paper prints it."""
    found = store.kept("validation-stable-paper-short")
    return [] if found is None else [row[0] < 0.05 for row in found["gammas"]]


def converged(store: Store) -> list[bool]:
    """Whether the loss after three epochs is within a tenth of the last, of each metric."""
    histories = [found["history"] for (found,) in pieces(store, "metric-{}")]
    return [history[3]["loss"] < 1.1 * history[-1]["loss"] for history in histories]


CLAIMS = (
    Claim(
        "model",
        "The trained model errs more than a hundred times less than the analytic one (the paper's network, all states)",
        less("model-squared-{}", "model-analytic", "over_range", factor=100.0),
    ),
    Claim(
        "model-ours",
        "Our model does",
        less("model-ours", "model-analytic", "over_range", factor=100.0),
    ),
    Claim(
        "horizon",
        "Training over 70 samples predicts 70 samples better than training on one (all states)",
        less("model-squared-{}", "model-one-step-{}", "over_range"),
    ),
    Claim("epochs", "Three epochs suffice for the metric (loss within a tenth of the long training's)", converged),
    Claim("untouched", "The filter leaves a stable controller alone (gamma_1 below 0.05 %)", untouched),
    Claim(
        "unfiltered",
        "Without the filter gains drawn from -40 to 40 are unstable",
        bounded("unstable", "none", as_paper=False),
    ),
    Claim("filtered", "Behind the filter they stay bounded", bounded("unstable", "paper-short")),
    Claim("negative", "So they do behind strictly negative gains", bounded("negative", "paper-short")),
    Claim("positive", "So they do behind strictly positive gains", bounded("positive", "paper-short")),
    Claim("high", "Above K_p = 100 the filter does not suffice", bounded("high", "paper-short", as_paper=False)),
    Claim(
        "bench",
        "Training on the bench beats training in simulation (I below II, each sine; paper: three of four)",
        less("rmse-default-paper-I-{}", "rmse-default-paper-II-{}", "rmse"),
    ),
    Claim(
        "bench-outside",
        "It does on the bench outside of the model's physics",
        less("rmse-outside-paper-I-{}", "rmse-outside-paper-II-{}", "rmse"),
    ),
    Claim(
        "fixed",
        "I beats fixed (90, 15) (each sine; paper: three of four)",
        less("rmse-default-paper-I-{}", "rmse-default-III-{}", "rmse"),
    ),
    Claim(
        "fixed-outside",
        "It does on the bench outside of the model's physics",
        less("rmse-outside-paper-I-{}", "rmse-outside-III-{}", "rmse"),
    ),
    Claim(
        "slow",
        "At 0.5 Hz fixed (90, 15) beats I",
        less("rmse-default-III-{}", "rmse-default-paper-I-{}", "rmse", at=slice(1)),
    ),
    Claim(
        "chatter",
        "The filter lowers chattering (u') in training",
        less("chatter-paper-long-{}", "chatter-none-{}", "chatter"),
    ),
)
