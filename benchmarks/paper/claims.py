# SPDX-License-Identifier: Apache-2.0
"""What the paper claims, as comparisons of pieces. How they are judged: `verdicts`; why they come out so: `reasons`."""

from __future__ import annotations

from benchmarks.paper.store import CASES, Store
from benchmarks.paper.verdicts import Claim, Comparisons, Outcome, bounded, less, numbers, outcome, pieces


def untouched(chosen: str) -> Comparisons:
    """Whether gamma_1 of each stable run is 0 as far as the paper prints it."""

    def look(store: Store) -> list[list[Outcome]]:
        found = pieces(store, f"validation-stable-{chosen}-{{}}")
        return [[outcome(numbers(one["gammas"])[0] < 0.05)] for (one,) in found]

    return look


def all_bounded(store: Store) -> list[list[Outcome]]:
    """Whether the runs behind our filter stay bounded, all draws of gains."""
    found = pieces(store, *(f"validation-{case}-ours-{{}}" for case in CASES if case != "stable"))
    return [[outcome(one["bounded"]) for one in row] for row in found]


def converged(store: Store) -> list[list[Outcome]]:
    """Whether the loss after three epochs is within a tenth of the last, of each metric."""
    histories = [
        (short["history"], long["history"]) for short, long in pieces(store, "metric-short-{}", "metric-long-{}")
    ]
    return [[outcome(short[-1]["loss"] < 1.1 * long[-1]["loss"])] for short, long in histories]


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
        seeds=False,
    ),
    Claim(
        "horizon",
        "Training over 70 samples predicts 70 samples better than training on one (all states)",
        less("model-squared-{}", "model-one-step-{}", "over_range"),
    ),
    Claim("epochs", "Three epochs suffice for the metric (loss within a tenth of the long training's)", converged),
    Claim("untouched", "The filter leaves a stable controller alone (gamma_1 below 0.05 %)", untouched("paper-short")),
    Claim("untouched-ours", "Ours does", untouched("ours")),
    Claim(
        "unfiltered",
        "Without the filter gains drawn from -40 to 40 are unstable",
        bounded("unstable", "none", as_paper=False),
    ),
    Claim("filtered", "Behind the filter they stay bounded", bounded("unstable", "paper-short")),
    Claim("negative", "So they do behind strictly negative gains", bounded("negative", "paper-short")),
    Claim("positive", "So they do behind strictly positive gains", bounded("positive", "paper-short")),
    Claim("high", "Above K_p = 100 the filter does not suffice", bounded("high", "paper-short", as_paper=False)),
    Claim("bounded-ours", "Behind ours all four draws of gains stay bounded, those above 100 too", all_bounded),
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
        less("chatter-paper-short-{}", "chatter-none-{}", "chatter"),
    ),
)
