# SPDX-License-Identifier: Apache-2.0
"""The page and the printed text: the paper's tables beside what was run, and its claims."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.paper import captions, choices, reasons, times
from benchmarks.paper.claims import CLAIMS
from benchmarks.paper.store import AUTHORITIES, CASES, FILTERS, LOSSES, PRINTED, TIMES, Result, Store
from benchmarks.paper.verdicts import Claim
from hydro_bridge.cli.console import Table
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.signals import FloatArray

Rows = list[list[str]]


def write(full: Store, quick: Store, page: Path | None, json: Path | None) -> None:
    """Print the claims, and write page and JSON where that was asked for."""
    table = Table(
        {"claim": "", "full": "the verdict", "full_as_paper": "comparisons as the paper says", "full_of": "comparisons",
         "quick_as_paper": "of --quick, without a verdict", "quick_of": "the same"},
        title="Claims of the paper",
    )  # fmt: skip
    for claim in CLAIMS:
        large, small = claim.verdict(full), claim.verdict(quick)
        table.add(
            claim=claim.text, full=large.words, full_as_paper=large.as_paper, full_of=large.count,
            quick_as_paper=small.as_paper, quick_of=small.count,
        )  # fmt: skip
    table.show(json)
    if page is not None:
        write_whole(page, text(full, quick).encode())
        print(f"wrote {page}", file=sys.stderr)


def text(full: Store, quick: Store) -> str:
    """The whole page; the quick size's tables only while pieces of the full one are missing."""
    parts = [captions.HEAD, _claims(full, quick), captions.OPEN, _times(full, quick)]
    complete = all(full.kept(name) is not None for kind in times.KINDS for name in kind.names(full.size))
    for store in (full,) if complete else (full, quick):
        parts.append(_sizes(store))
        if store.names():
            parts += [
                _models(store),
                _metrics(store),
                _validation(store),
                _rmse(store),
                _chatter(store),
                _sensitivity(store),
            ]
    return "\n".join(parts)


def _claims(full: Store, quick: Store) -> str:
    rows = []
    for claim in CLAIMS:
        cells = [claim.verdict(store).cell(store.size.seeds, judged=store is full) for store in (full, quick)]
        rows.append([claim.text, *cells, _why(claim, full, quick)])
    return captions.CLAIMS + "\n" + markdown(["claim", "full", "quick", "why"], rows)


def _why(claim: Claim, full: Store, quick: Store) -> str:
    """By the full size, or by the quick one where the full one was not run."""
    for store in (full, quick):
        if claim.verdict(store).count:
            return f"*{store.size.name}*: {reasons.why(claim.key, store)}"
    return ""


def _times(full: Store, quick: Store) -> str:
    head = ["pieces", "full: there", "CPU of one [s]", "quick: there", "CPU of one [s]"]
    hours = {"full": times.whole(full, quick), "quick": times.whole(quick, quick)}
    told = "; ".join(f"{name} {found:.2g} h" for name, found in hours.items() if found is not None)
    line = f"\nAll pieces of a size, on one core: {told}.\n" if told else ""
    return captions.TIMES + "\n" + markdown(head, times.rows(full, quick)) + line


def _sizes(store: Store) -> str:
    size, done = store.size, [one for name in store.names() if (one := store.kept(name)) is not None]
    spent = sum(one["cpu"] for one in done) / 60.0
    told = (
        f"{size.seeds} seeds; networks {size.model_epochs} epochs; metrics at most {size.metric_epochs} epochs on "
        f"{size.rollouts} rollouts;\nruns of {size.validation_seconds:g} s; II {size.simulated_episodes} and I "
        f"{size.bench_episodes} episodes of {PRINTED['training_agent']['steps']} steps.\n"
    )
    days = sorted({one.get("made", "") for one in done} - {""})
    when = f", made from {days[0]} to {days[-1]}" if days else ""
    return f"\n## Size {size.name}\n\n{told}{len(done)} pieces are there, {spent:.1f} min of CPU{when}.\n"


def _models(store: Store) -> str:
    printed, rows = PRINTED["rmse_model"], []
    names = {f"network, loss {loss}": _all(store, f"model-{loss}-{{}}") for loss in LOSSES}
    names |= {who: _all(store, f"model-{who}") for who in ("analytic", "ours")}
    for name, found in names.items():
        if found:
            force = [cell([one["load_force"][str(n)] for one in found]) for n in TIMES]
            rows.append([name, *cells([one["over_range"] for one in found], 5), *force])
    for who in ("trained", "analytic"):
        rows.append([f"paper, {who}", *(f"{value:.4f}" for value in printed[who]), *[""] * len(TIMES)])
    head = ["", *printed["states"], *(f"f_l after {n} [N]" for n in TIMES)]
    return captions.MODELS + "\n" + markdown(head, rows)


def _metrics(store: Store) -> str:
    rows = []
    for told, name, place in (("0", "short", 0), ("3", "short", -1), ("long", "long", -1)):
        if found := _all(store, f"metric-{name}-{{}}"):
            after = [one["history"][place] for one in found]
            keys = ("stable_verified", "unstable_found")
            shares = [cell(100.0 * np.array([one[key] for one in after], float), missing="none") for key in keys]
            lengths = sorted(len(one["history"]) - 1 for one in found)
            epochs = told if name == "short" else f"{lengths[0]} to {lengths[-1]}"
            rows.append([epochs, cell([one["loss"] for one in after], 3), *shares, str(len(found))])
    if ours := store.kept("metric-ours"):
        shares = [f"{100.0 * ours[key]:.2f}" for key in ("stable_verified", "unstable_found")]
        rows.append([f"ours, as shipped: {ours['epochs']}", "", *shares, "1"])
    head = ["epochs", "loss", "stable samples verified [%]", "unstable samples found [%]", "seeds"]
    found = _all(store, "metric-short-{}")
    labels = {name: sum(one["rollouts"][name] for one in found) for name in ("stable", "unstable", "neither")}
    told = "Rollouts by label, all seeds: " + ", ".join(f"{count} {name}" for name, count in labels.items()) + ".\n"
    return captions.METRICS + "\n" + (markdown(head, rows) + "\n" + told if rows else "not run yet\n")


def _validation(store: Store) -> str:
    rows: Rows = []
    for name in CASES:
        for chosen in FILTERS:
            if found := _all(store, f"validation-{name}-{chosen}-{{}}"):
                bounded = f"{sum(one['bounded'] for one in found)}/{len(found)}"
                sizes = (cell([one[key] for one in found], digits) for key, digits in (("rmse", 2), ("chatter", 3)))
                rows.append([name, chosen, bounded, *sizes, *cells([one["gammas"] for one in found], 3)])
        if name in PRINTED["val_cont"]:
            rows.append([name, "printed", "", "", "", *(f"{value:g}" for value in PRINTED["val_cont"][name])])
    head = ["gains", "filter", "bounded", "RMSE [N]", "u' [A/s]", "gamma_1 [%]", "gamma_2 [%]", "gamma_3",
            "gamma_4 [%]", "gamma_5"]  # fmt: skip
    return captions.VALIDATION + "\n" + (markdown(head, rows) if _any(rows) else "not run yet\n")


def _rmse(store: Store) -> str:
    rows: Rows = []
    for bench in ("default", "outside"):
        names = {"III": f"rmse-{bench}-III-{{}}"}
        names |= {f"{who}, {auth}": f"rmse-{bench}-{auth}-{who}-{{}}" for auth in AUTHORITIES for who in ("I", "II")}
        for who, name in names.items():
            found = _all(store, name)
            for key, told in (("rmse", who), ("last", f"{who}, last policy")):
                if found and key in found[0]:
                    rows.append([bench, told, *cells([one[key] for one in found], 2), str(len(found))])
    rows += [["paper's", who, *(f"{value:.2f}" for value in PRINTED["rmse"][who]), ""] for who in ("I", "II", "III")]
    head = ["bench", "controller, authority", *(f"{f:g} Hz" for f in PRINTED["rmse"]["frequencies"]), "seeds"]
    return captions.RMSE + "\n" + markdown(head, rows)


def _chatter(store: Store) -> str:
    rows = []
    for chosen in ("none", "paper-short", "ours"):
        if found := _all(store, f"chatter-{chosen}-{{}}"):
            trips = sum(one["trips"] for one in found)
            done = sum(one["episodes"] for one in found)
            rows.append([chosen, cell([one["chatter"] for one in found], 4), str(trips), str(done), str(len(found))])
    body = markdown(["filter", "u' RMS [A/s]", "trips", "episodes", "seeds"], rows) if rows else "not run yet\n"
    return captions.CHATTER + "\n" + body


def _sensitivity(store: Store) -> str:
    rows = []
    for name in (choices.CHOSEN, *choices.VARIED):
        if found := choices.scores(store, name):
            rows.append([name, *cells(found, 3), str(len(found))])
    told = len(rows) > 1
    head = ["choice", "best score", "last score", "seeds"]
    return captions.SENSITIVITY + "\n" + (markdown(head, rows) if told else "not run yet\n")


def _any(rows: Rows) -> bool:
    """Whether there is more than printed numbers."""
    return any(row[1] != "printed" for row in rows)


def _all(store: Store, name: str) -> list[Result]:
    """What is there of a piece, over seeds."""
    names = [name.format(seed) for seed in range(store.size.seeds)] if "{}" in name else [name]
    return [found for one in names if (found := store.kept(one)) is not None]


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


def markdown(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)
