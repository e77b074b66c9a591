# SPDX-License-Identifier: Apache-2.0
"""What a report says about physics that has no name, held against the truth.

What a right form is was fixed in `kinds`, blind; here the texts of the grammar's laws are read in those words: what a
law depends on, the powers of the signals that multiply, and a state, unless it hangs on time alone.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from benchmarks.beyond_the_table.cases import Case
from benchmarks.beyond_the_table.kinds import Kind
from hydro_core.cli.console import Table
from hydro_sim.model.grammar import LAWS
from hydro_sim.model.laws import REVERSING_TEXT

COLUMNS = {
    "case": "kind and round; clean: nothing is missing",
    "beside": "named causes that are concealed too; dB: signal over noise",
    "verdict": "",
    "gap": "root of the worst channel's held-out squared error before, over its noise floor's",
    "names": "share of the held-out gap (squared error above the noise, channels added up in noise floors) that the "
    "names alone close",
    "all": "the same by names and closures: what is handed back",
    "place": "whether the closures, or else the largest part of the remainder, are in the right equation",
    "form": "law of the right form, as `kinds` fixes it",
    "named": "whether what is named is what is concealed, nothing else; clean: nothing is claimed",
    "closures": "what models the rest",
    "values": "half `named`: estimate [95 % interval] of each parameter, ! where the true value is missed",
    "left": "worst channel's held-out error over its noise floor",
    "cpu": "s of processor time that `diagnose` took",
}
SHOWS = 0.05
"""Squared error above the noise, in noise floors, from which there is something to close."""


def scored(case: Case, result: Mapping[str, Any]) -> dict[str, Any]:
    """Row of the table; shares are nan where nothing shows above the noise, and where `diagnose` refused."""
    report, nan = result["report"], float("nan")
    beside = ", ".join([*case.named, *([f"{case.decibels} dB"] if case.decibels is not None else [])])
    facts = {"case": case.name, "beside": beside, "cpu": result["cpu"]}
    if report is None:
        return {**facts, "verdict": "refused", "gap": nan, "names": nan, "all": nan, "place": False, "form": False,
                "named": False, "closures": result["said"][:100], "values": "", "left": nan}  # fmt: skip
    errors, closures = report["fit"]["holdout"], report["closures"]
    before, names, after = (_gap(errors, key) for key in ("rmse_before", "rmse_named", "rmse_after"))
    nothing = case.kind is None or before < SHOWS
    claimed = sorted(_cause(effect) if case.causes else effect["id"] for effect in report["effects"])
    kind = case.kind
    return {
        **facts,
        "verdict": report["verdict"],
        "gap": max(error["rmse_before"] / error["noise_floor"] for error in errors.values()),
        "names": nan if nothing else 1.0 - names / before,
        "all": nan if nothing else 1.0 - after / before,
        "place": not closures if kind is None else _place(report) in places(kind),
        "form": kind is not None and any(right_form(kind, closure) for closure in closures),
        "named": claimed == sorted(case.named) and (kind is not None or not closures),
        "closures": "; ".join(f"{closure['form']}: {closure['expression']}" for closure in closures)
        + (f" (named: {', '.join(claimed)})" if claimed != sorted(case.named) else ""),
        "values": "; ".join(_estimates(case, report["effects"])),
        "left": max(error["rmse_after"] / error["noise_floor"] for error in errors.values()),
    }


def _cause(effect: Mapping[str, Any]) -> str:
    """Id and options of an effect as `named` writes them."""
    return " ".join([effect["id"], *(str(value) for _, value in sorted(effect["options"].items()))])


def _estimates(case: Case, effects: Iterable[Mapping[str, Any]]) -> Iterable[str]:
    for effect in effects:
        truth = case.causes.get(_cause(effect), {})
        for name, found in effect["parameters"].items():
            if name in truth:
                low, high = found["ci95"] or (np.nan, np.nan)
                missed = "" if low <= truth[name] <= high else " !"
                yield f"{name} {found['value']:.5g} [{low:.5g}, {high:.5g}]{missed}"


def _gap(errors: Mapping[str, Mapping[str, Any]], key: str) -> float:
    """Squared error above the noise, in noise floors, channels added up; `rmse_named` is `rmse_after` if absent."""
    values = [(error.get(key, error["rmse_after"]) / error["noise_floor"]) ** 2 for error in errors.values()]
    return float(max(sum(max(value - 1.0, 0.0) for value in values), 1e-9))


def _place(report: Mapping[str, Any]) -> str:
    """Equation of the closure that closes most, of the remainder's largest part where there is none."""
    if report["closures"]:
        return str(max(report["closures"], key=lambda closure: closure["share_closed"])["equation"])
    places = (report["remainder"] or {}).get("location", [])
    return str(max(places, key=lambda place: place["share"])["equation"]) if places else ""


def table(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Rows for people; the summary is its title."""
    made = Table(COLUMNS, title=summary(rows))
    for row in rows:
        shares = {key: round(row[key], 3) for key in ("gap", "names", "all", "left")}
        made.add(**{**row, **shares, **{key: "yes" if row[key] else "no" for key in ("place", "form", "named")}})
    return made


def summary(rows: Sequence[Mapping[str, Any]]) -> str:
    """Issue 18's figures in one line."""
    clean = [row for row in rows if row["case"].startswith("clean_")]
    outside = [row for row in rows if not row["case"].startswith("clean_")]
    beside = [row for row in outside if row["beside"] and "dB" not in row["beside"]]
    parts = []
    for key, label in (("names", "closed by names"), ("all", "by names and closures")):
        shares = [row[key] for row in outside if np.isfinite(row[key])]
        if shares:
            low, middle = np.percentile(shares, [10, 50])
            parts.append(f"{label}: median {middle:.2f}, 10th percentile {low:.2f}, least {min(shares):.2f}")
    for key, label in (("place", "right equation"), ("form", "right form")):
        parts.append(f"{label} {sum(row[key] for row in outside)} of {len(outside)}")
    parts.append(f"names right beside {sum(row['named'] for row in beside)} of {len(beside)}")
    parts.append(f"alone no name {sum(row['named'] for row in outside if row not in beside)}"
                 f" of {len(outside) - len(beside)}")  # fmt: skip
    intervals = [one for row in rows for one in row["values"].split("; ") if one]
    if intervals:
        parts.append(f"intervals that hold {sum(not one.endswith('!') for one in intervals)} of {len(intervals)}")
    parts.append(f"claims on clean {sum(not row['named'] for row in clean)} of {len(clean)}")
    times = [row["cpu"] for row in rows]
    parts.append(f"CPU median {np.median(times):.0f} s, most {max(times):.0f} s")
    return "; ".join(parts)


def right_form(kind: Kind, closure: Mapping[str, Any]) -> bool:
    """Whether an entry of `closures` is a law that depends on what it should, with the right power, or with memory.

    The power is that of the signals in the law (a sign counts none); a state that hangs on time alone is no memory.
    """
    if closure["form"] != "law" or closure["equation"] not in places(kind):
        return False
    text = closure["expression"].partition(" * ")[2].replace(f", {REVERSING_TEXT}", "")
    law = next((law for law in LAWS if text == law.text or text.startswith(f"{law.text}, ")), None)
    if law is None:
        return False
    variables = {law.where if one == "force" else one for one in law.uses}
    memory = law.memory_element is not None and law.memory_element.signal != "time"
    right = variables == set(kind.variables.split()) and memory == kind.memory
    return right and (kind.degree is None or law.degree == kind.degree)


def places(kind: Kind) -> frozenset[str]:
    """Ids of `closures.equation` that are right; `pressure` is both chambers'."""
    found = frozenset(kind.equations.split())
    return found | {"pressure"} if {"pressure_a", "pressure_b"} <= found else found
