# SPDX-License-Identifier: Apache-2.0
"""Standards of the diagnosis (diagnosis.md), each with its goal and its result."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Callable, Sequence
from math import sqrt
from typing import Any

import numpy as np

from hydro_bridge.cli.console import Table
from hydro_diagnosis.blind_benchmark.facts import Result

COLUMNS = {
    "standard": "what is asked for",
    "goal": "",
    "reached": "share of cases, or a percentile",
    "count": "of how many",
    "wilson": "95 % interval of the share (Wilson)",
    "met": "whether the goal is met",
}


def wilson(hits: int, count: int) -> tuple[float, float]:
    """95 % interval of a share (Wilson 1927)."""
    if not count:
        return 0.0, 1.0
    z, share = 1.959964, hits / count
    middle = (share + z * z / (2 * count)) / (1 + z * z / count)
    reach = z / (1 + z * z / count) * sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return max(middle - reach, 0.0), min(middle + reach, 1.0)


def standards(results: Sequence[Result]) -> Table:
    """The table of standards; those without a case are left out."""
    table = Table(COLUMNS, title=f"{len(results)} sealed cases")
    kinds: dict[str, list[Result]] = defaultdict(list)
    for result in results:
        kinds[result.case.kind].append(result)
    placed = [result for result in results if result.case.kind not in ("clean", "faint")]
    _share(table, "single concealed effect named exactly, nothing else", 0.98, kinds["single"], lambda r: r.exact)
    _share(table, "two effects: both named, nothing else", 0.95, kinds["pair"], lambda r: r.exact)
    _share(table, "three effects: all named, nothing else", 0.90, kinds["triple"], lambda r: r.exact)
    _share(table, "same cause, other form: cause named, nothing else", 0.90, kinds["form"], lambda r: r.exact)
    _share(table, "wrong value in the bench file named", 0.90, kinds["value"], lambda r: r.exact)
    _share(table, "nothing missing: any claim", -0.01, kinds["clean"], lambda r: not r.exact)
    _share(table, "outside the table: unknown or partly, right equation", 0.90, kinds["outside"],
           lambda r: r.admitted and r.located)  # fmt: skip
    _share(table, "outside the table: wrong name", -0.05, kinds["outside"], lambda r: bool(r.claimed))
    _share(table, "right equation", 0.99, placed, lambda r: r.located)
    _numbers(table, results)
    _fits(table, [result for result in placed if result.case.kind != "outside"])
    _times(table, results)
    _share(table, "faint (a fifth to all of the smallest single): named", None, kinds["faint"], lambda r: r.exact)
    _share(table, "faint: wrong name", None, kinds["faint"], lambda r: bool(r.spurious))
    _share(table, "refused: recordings that cannot be diagnosed", None, results, lambda r: r.refused)
    return table


def _share(
    table: Table, standard: str, goal: float | None, results: Sequence[Result], test: Callable[[Result], bool]
) -> None:
    """A row with a share; a negative goal is an upper limit."""
    if not results:
        return
    hits = sum(test(result) for result in results)
    _row(table, standard, goal, hits, len(results))


def _row(table: Table, standard: str, goal: float | None, hits: int, count: int) -> None:
    low, high = wilson(hits, count)
    share = hits / count
    words = "" if goal is None else f">= {goal:.0%}" if goal > 0 else f"<= {-goal:.0%}"
    met = "" if goal is None else _said(share >= goal if goal > 0 else share <= -goal)
    table.add(standard=standard, goal=words, reached=f"{hits}/{count} = {share:.1%}", count=count,
              wilson=f"{low:.1%} to {high:.1%}", met=met)  # fmt: skip


def _figure(table: Table, standard: str, goal: str, reached: str, count: int, met: bool) -> None:
    table.add(standard=standard, goal=goal, reached=reached, count=count, wilson="", met=_said(met))


def _said(met: bool) -> str:
    return "yes" if met else "no"


def _numbers(table: Table, results: Sequence[Result]) -> None:
    """Errors and coverage of the numbers of what was named, where the form is the library's own."""
    kinds = ("single", "value", "pair", "triple")
    estimates = [one for result in results if result.case.kind in kinds for one in result.estimates]
    if not estimates:
        return
    middle, tail = np.percentile([one.error for one in estimates], [50, 95])
    _figure(table, "parameter error, median", "<= 0.5%", f"{middle:.2%}", len(estimates), middle <= 0.005)
    _figure(table, "parameter error, 95th percentile", "<= 3%", f"{tail:.2%}", len(estimates), tail <= 0.03)
    middle, tail = np.percentile([one.error_of_size for one in estimates], [50, 95])
    table.add(standard="the same over the effect's size (of a ratio of 1.05, over 0.05)", goal="", met="", wilson="",
              reached=f"median {middle:.2%}, p95 {tail:.2%}", count=len(estimates))  # fmt: skip
    hits = sum(one.inside for one in estimates)
    low, high = wilson(hits, len(estimates))
    share = hits / len(estimates)
    table.add(standard="95 % intervals that hold the truth", goal="92% to 98%", reached=f"{share:.1%}",
              count=len(estimates), wilson=f"{low:.1%} to {high:.1%}", met=_said(0.92 <= share <= 0.98))  # fmt: skip


def _fits(table: Table, results: Sequence[Result]) -> None:
    """Held-out errors, over the noise floor and over what the true structure reaches."""
    over = [result.held_out for result in results if result.held_out is not None]
    if not over:
        return
    middle, tail = np.percentile(over, [50, 95], method="higher")  # some may diverge
    _figure(table, "held-out error over noise floor, median", "<= 1.03", f"{middle:.3f}", len(over), middle <= 1.03)
    _figure(table, "held-out error over noise floor, 95th percentile", "<= 1.3", f"{tail:.3f}", len(over), tail <= 1.3)
    true = [result.held_out_true for result in results if result.held_out_true is not None]
    against = [r.held_out / r.held_out_true for r in results if r.held_out is not None and r.held_out_true]
    if against:
        top, far = (float(np.percentile(one, 95, method="higher")) for one in (true, against))
        table.add(standard="the same for the fit of the true structure", goal="", count=len(true), wilson="", met="",
                  reached=f"median {np.median(true):.3f}, p95 {top:.3f}")  # fmt: skip
        table.add(standard="held-out error over that of the true structure", goal="", count=len(against), wilson="",
                  met="", reached=f"median {np.median(against):.3f}, p95 {far:.3f}")  # fmt: skip


def _times(table: Table, results: Sequence[Result]) -> None:
    wall = [float(result.answer["wall"]) for result in results]
    cpu = [float(result.answer["cpu"]) for result in results]
    _figure(table, "time per case, median", "<= 10 s", f"{np.median(wall):.1f} s ({np.median(cpu):.1f} s CPU)",
            len(wall), float(np.median(wall)) <= 10.0)  # fmt: skip
    _figure(table, "time per case, longest", "<= 60 s", f"{max(wall):.1f} s ({max(cpu):.1f} s CPU)", len(wall),
            max(wall) <= 60.0)  # fmt: skip


def confusion(results: Sequence[Result]) -> dict[str, dict[str, int]]:
    """Counts of diagnosed against concealed causes, over cases with one concealed cause or none."""
    matrix: dict[str, Counter[str]] = defaultdict(Counter)
    for result in results:
        names = [*result.case.effects, *result.case.outside] or ["nothing"]
        if len(names) == 1 and result.case.kind != "faint":
            matrix[names[0]].update(result.claimed or [result.verdict])
    return {name: dict(counter) for name, counter in sorted(matrix.items())}


def failures(results: Sequence[Result]) -> list[dict[str, Any]]:
    """Cases that missed the requirement of their kind, with their diagnosis."""
    return [
        {
            "case": result.case.name,
            "kind": result.case.kind,
            "noise": result.case.noise,
            "truth": {**result.case.effects, **result.case.outside},
            "verdict": result.verdict,
            "claimed": {e["id"]: {n: p["value"] for n, p in e["parameters"].items()} for e in result.effects},
            "places": result.places,
            "why": result.answer["refused"] or "",
        }
        for result in results
        if not result.passed
    ]
