# SPDX-License-Identifier: Apache-2.0
"""The page and the printed text: the paper's tables beside what was run, and its claims.

Claims are comparisons of pieces, seed by seed: how many came out as the paper says, and how many are equal. The filter
meant is the paper's after its three epochs (*paper-short*) where a claim does not say ours.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import numpy as np

from benchmarks.paper.store import AUTHORITIES, CASES, FILTERS, LOSSES, OWN_GAINS, PRINTED, TIMES, Result, Store
from hydro_core.cli.console import Table
from hydro_core.files.atomic import write_atomic
from hydro_core.signals import FloatArray

HEAD = """# The paper, row by row

*This page is made by `make paper` from the pieces that were run; do not edit it.*

The paper's own method on the emulated bench, beside the paper's numbers and ours: orders and signs compare, Newtons do
not. The pieces lie in benchmarks/paper/results; `make paper ARGS=--fresh` runs them again, `ARGS=--quick` small ones in
minutes. Cells: mean ± standard deviation over seeds.

What the paper leaves open: errors are over each state's range. gamma_2 and gamma_4 count violations. v has the sign of
the erratum. A, B, K are exact slopes. II is trained on the shipped model, not on the 2x32 network. Batch 256, target
entropy -2, fixed scales of the observation, the reward's factor 0.02. *I* is the best policy by the run's own
examinations; its actor learns at a tenth of the paper's rate and not before an episode of the bench is there.
"""
TABLES = {
    "Claims": "Comparisons that came out as the paper says, over seeds and conditions.",
    "Table rmse_model": "70-sample predictions of x without noise, over each state's range; *squared*: the loss as "
    "meant, *printed*: as printed, *one-step*: H = 1.",
    "Table training_metric": "On rollouts of the paper's network model that were not trained on; ours is solved, on "
    "the shipped model and its rollouts.",
    "Table val_cont": "200 N at 1 Hz, gains drawn by `benchmarks.paper.validation`; *paper-short* after 3 epochs and "
    "*paper-long* after all at 100 Hz, *ours* at 1 kHz; of a run that tripped: up to there.",
    "Tables training_agent and rmse": "Force RMSE [N], sines of 300 N from rest, no filter.",
    "Chattering in training": "Of I's first two episodes, default bench, paper's authority.",
    "The paper's own row": "Force RMSE [N] on a bench that was fitted to four numbers, the printed row III "
    "(benchmarks/paper/own_row_truth.yaml): the nominal one with a spring of 60 kN/m in place of 20, a load cell "
    "of 22 Hz, a velocity 0.5 ms old and 0.945 of the valve's gain. Sines of 300 N from rest. The filter is "
    "*paper-short* at 100 Hz, its network and metric trained on this bench; II on its bench file. `make paper "
    "ARGS='--only own-row'`, ten minutes of CPU a seed.",
}
OWN_NOTES = """
**Tried** (2026-11-28, one noise seed, velocity 0.5 ms old; RMSE over the printed row at the four sines):

| spring [kN/m] | load cell | valve's gain | over the printed row | without a filter |
| --- | --- | --- | --- | --- |
| 20 | ideal | 0.98 | 0.90, 0.97, 1.00, 1.09 | stable up to K_p = 300, which has a third of the error |
| 30 | ideal | 0.97 | 0.93, 0.97, 0.97, 1.00 | the same |
| 30 | 25 Hz | 0.972 | 0.88, 0.95, 1.01, 1.13 | K_p = 105 has 0.86 of the error, 150 trips |
| 40 | 25 Hz | 0.962 | 0.92, 0.98, 1.01, 1.10 | the same |
| **60** | **22 Hz** | **0.945** | 0.94, 1.00, 1.02, 1.09 | the same, 120 has 0.75 of the error |
| 80 | 20 Hz | 0.927 | 1.00, 1.05, 1.07, 1.14 | K_p = 150 is stable |
| 100 | 15 Hz | 0.91 | 1.05, 1.12, 1.16, 1.25 | 150 trips |

**Not reached**: a bench with the printed row on which K_p between 100 and 120 is unstable by itself. What makes high
gains unstable is the load cell's lag, and a lag slow enough for that bends the row: its error grows with the square of
the frequency.

With filters of `--quick` size (one seed, 2026-11-28): K_p = 105 leaves 15 to 33 N, 150 16 to 42 N, 300 trips on three
sines of four, and (90, 15) itself trips on two: the filter spoils the stable gains as well.
"""
Row = list[str]
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


def _on_own(comparisons: Comparisons) -> Comparisons:
    return lambda store: comparisons(store.own)


def _high_on_own(store: Store) -> Iterator[float]:
    for kp in OWN_GAINS[1:]:
        yield from less("unfiltered-90-{}", f"filtered-{kp:g}-{{}}", "rmse", factor=2.0)(store.own)


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
    "On a bench with the paper's row III: I below II (each sine)":
        _on_own(less("rmse-default-paper-I-{}", "rmse-default-paper-II-{}", "rmse")),
    "There I beats fixed (90, 15) (each sine)":
        _on_own(less("rmse-default-paper-I-{}", "unfiltered-90-{}", "rmse")),
    "There at 0.5 Hz fixed (90, 15) beats I":
        _on_own(less("unfiltered-90-{}", "rmse-default-paper-I-{}", "rmse", at=slice(1))),
    "There each of five K_p above 100 behind the filter trips or has twice the error of (90, 15) (each sine)":
        _high_on_own,
    "There fixed (90, 15) behind the filter does neither":
        _on_own(less("filtered-90-{}", "unfiltered-90-{}", "rmse", factor=0.5)),
    "The filter lowers chattering (u') in training": less("chatter-paper-short-{}", "chatter-none-{}", "chatter"),
}  # fmt: skip


def counts(store: Store, comparisons: Comparisons) -> str:
    """`as the paper says of all, so many equal`."""
    found = list(comparisons(store))
    equal = sum(one == 0.0 for one in found)
    told = f"{sum(one > 0.0 for one in found)} of {len(found)}" + (f", {equal} equal" if equal else "")
    return told if found else "not run"


def write(store: Store, page: Path | None, json: Path | None) -> None:
    """Print the claims, and write page and JSON where that was asked for."""
    table = Table({"claim": "", "held": "comparisons as the paper says"}, title="Claims")
    for claim, comparisons in CLAIMS.items():
        table.add(claim=claim, held=counts(store, comparisons))
    table.show(json)
    if page is not None:
        write_atomic(page, text(store).encode())
        print(f"wrote {page}", file=sys.stderr)


def text(store: Store) -> str:
    """The whole page."""
    parts = [HEAD, section("Claims", ["claim", "held"], [[claim, counts(store, how)] for claim, how in CLAIMS.items()])]
    size, made = store.size, [one for name in store.names() if (one := store.kept(name)) is not None]
    parts.append(
        f"\n**Size {size.name}**: {size.seeds} seeds; networks {size.model_epochs} epochs; metrics at most "
        f"{size.metric_epochs} epochs on\n{size.rollouts} rollouts; runs of {size.validation_seconds:g} s; II "
        f"{size.simulated_episodes} and I {size.bench_episodes} episodes of {PRINTED['training_agent']['steps']} "
        f"steps.\n{len(made)} pieces, {sum(one['cpu'] for one in made) / 60.0:.0f} min of CPU, the last of "
        f"{max((one['made'] for one in made), default='')}.\n"
    )
    return "".join([*parts, *_tables(store)])


def _tables(store: Store) -> Iterator[str]:
    printed = PRINTED["rmse_model"]
    head = ["", *printed["states"], *(f"f_l after {n} [N]" for n in TIMES)]
    yield section("Table rmse_model", head, [*_models(store), *(
        [f"paper, {who}", *(f"{value:.4f}" for value in printed[who]), *[""] * len(TIMES)]
        for who in ("trained", "analytic")
    )])  # fmt: skip
    head = ["epochs", "loss", "stable samples verified [%]", "unstable samples found [%]", "seeds"]
    yield section("Table training_metric", head, _metrics(store))
    head = ["gains", "filter", "bounded", "RMSE [N]", "u' [A/s]", "gamma_1 [%]", "gamma_2 [%]", "gamma_3",
            "gamma_4 [%]", "gamma_5"]  # fmt: skip
    yield section("Table val_cont", head, _validation(store))
    head = ["controller, authority", *(f"{f:g} Hz" for f in PRINTED["rmse"]["frequencies"]), "seeds"]
    yield section("Tables training_agent and rmse", head, _rmse(store))
    head, rows = ["filter", "u' RMS [A/s]", "trips", "episodes", "seeds"], []
    for chosen in ("none", "paper-short", "ours"):
        if found := [one for (one,) in pieces(store, f"chatter-{chosen}-{{}}")]:
            sums = [str(sum(one[key] for one in found)) for key in ("trips", "episodes")]
            rows.append([chosen, cell([one["chatter"] for one in found], 4), *sums, str(len(found))])
    yield section("Chattering in training", head, rows)
    head = ["controller", "filter", *(f"{f:g} Hz" for f in PRINTED["rmse"]["frequencies"]), "seeds"]
    yield section("The paper's own row", head, _own_row(store.own)) + OWN_NOTES


def _models(store: Store) -> Iterator[Row]:
    names = {f"network, loss {loss}": f"model-{loss}-{{}}" for loss in LOSSES}
    for told, name in (names | {who: f"model-{who}" for who in ("analytic", "ours")}).items():
        if found := [one for (one,) in pieces(store, name)]:
            force = [cell([one["load_force"][str(n)] for one in found]) for n in TIMES]
            yield [told, *cells([one["over_range"] for one in found], 5), *force]


def _metrics(store: Store) -> Iterator[Row]:
    keys = ("stable_verified", "unstable_found")
    for name, place in (("short", 0), ("short", -1), ("long", -1)):
        if found := [one["history"] for (one,) in pieces(store, f"metric-{name}-{{}}")]:
            after = [one[place] for one in found]
            shares = [cell(100.0 * np.array([one[key] for one in after], float), missing="none") for key in keys]
            lengths = sorted({0 if place == 0 else len(one) - 1 for one in found})
            epochs = f"{lengths[0]} to {lengths[-1]}" if len(lengths) > 1 else str(lengths[0])
            yield [epochs, cell([one["loss"] for one in after], 3), *shares, str(len(found))]
    if ours := store.kept("metric-ours"):
        yield ["ours, solved", "", f"{100.0 * ours['stable_verified']:.2f}", "", "1"]


def _validation(store: Store) -> Iterator[Row]:
    for name in CASES:
        for chosen in FILTERS:
            if found := [one for (one,) in pieces(store, f"validation-{name}-{chosen}-{{}}")]:
                bounded = f"{sum(one['bounded'] for one in found)}/{len(found)}"
                sizes = (cell([one[key] for one in found], digits) for key, digits in (("rmse", 2), ("chatter", 3)))
                yield [name, chosen, bounded, *sizes, *cells([one["gammas"] for one in found], 3)]
        if name in PRINTED["val_cont"]:
            yield [name, "printed", "", "", "", *(f"{value:g}" for value in PRINTED["val_cont"][name])]


def _rmse(store: Store) -> Iterator[Row]:
    names = {"III": "rmse-default-III-{}"}
    names |= {f"{who}, {auth}": f"rmse-default-{auth}-{who}-{{}}" for auth in AUTHORITIES for who in ("I", "II")}
    for who, name in names.items():
        found = [one for (one,) in pieces(store, name)]
        for key, told in (("rmse", who), ("last", f"{who}, last policy")):
            if found and key in found[0]:
                yield [told, *cells([one[key] for one in found], 2), str(len(found))]
    for who in ("I", "II", "III"):
        yield [f"{who}, paper's", *(f"{one:.2f}" for one in PRINTED["rmse"][who]), ""]


def _own_row(own: Store) -> Iterator[Row]:
    names = {("III: fixed (90, 15)", "none"): "unfiltered-90-{}"}
    names |= {(f"fixed ({kp:g}, 15)", "none"): f"unfiltered-{kp:g}-{{}}" for kp in OWN_GAINS[1:]}
    names |= {(f"{who}, paper's authority", "none"): f"rmse-default-paper-{who}-{{}}" for who in ("I", "II")}
    names |= {(f"fixed ({kp:g}, 15)", "paper-short"): f"filtered-{kp:g}-{{}}" for kp in OWN_GAINS}
    for told, name in names.items():
        if found := [one["rmse"] for (one,) in pieces(own, name)]:
            yield [*told, *cells(found, 2), str(len(found))]
    for who in ("I", "II", "III"):
        yield [f"{who}, paper's", "", *(f"{one:.2f}" for one in PRINTED["rmse"][who]), ""]


def section(title: str, head: Sequence[str], rows: Iterator[Row] | list[Row]) -> str:
    """A heading, its sentence and its table."""
    lines = [head, ["---"] * len(head), *rows]
    body = "".join("| " + " | ".join(line) + " |\n" for line in lines) if len(lines) > 2 else "not run\n"
    return f"\n## {title}\n\n{TABLES[title]}\n\n{body}"


def cell(values: Sequence[float] | FloatArray, digits: int = 2, *, missing: str = "stopped") -> str:
    """Mean and standard deviation; where some are not finite, how many, and why: `missing`."""
    array = np.array(values, float)
    lacking = int(np.isnan(array).sum())
    if lacking:
        return f"{missing} {lacking}/{len(array)}"
    mean = f"{array.mean():.{digits}f}"
    return f"{mean} ± {array.std(ddof=1):.{digits}f}" if len(array) > 1 else mean


def cells(rows: Sequence[Sequence[float]], digits: int) -> list[str]:
    """A cell for each column."""
    return [cell(column, digits) for column in zip(*rows, strict=True)]
