# SPDX-License-Identifier: Apache-2.0
"""What a report says about a case, held against the truth."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.foreign_truth.cases import Case
from hydro_bridge.cli.console import Table

COLUMNS = {
    "case": "",
    "kind": "",
    "verdict": "",
    "right": "named exactly; clean: nothing claimed; outside: no name, the remainder in the right equation; late: "
    "that, and said so; unusable: refused in a sentence",
    "values": "estimate [95 % interval] of each parameter in SI units, true value in parentheses, ! where it is missed",
    "rival": "nearest: what it leaves more of BIC; = where the two cannot be told apart",
    "held_out": "error over the noise floor of the worst channel, over the held-out windows that a model can predict",
    "all": "the same over all held-out windows",
    "seconds": "s, wall time of the command",
}


def cause(effect: Mapping[str, Any]) -> str:
    """Id and options of an effect as `Case.causes` writes them."""
    return " ".join([effect["id"], *(str(value) for _, value in sorted(effect["options"].items()))])


def scored(case: Case, report: Mapping[str, Any] | None, said: str, seconds: float) -> dict[str, Any]:
    """Row of the table and what the summary counts; `report` is None where the command refused, by `said`."""
    facts: dict[str, Any] = {"case": case.name, "kind": case.kind, "seconds": round(seconds, 1)}
    if report is None:
        told = case.kind == "unusable" and said.startswith("error: ") and "Traceback" not in said
        return {**facts, "verdict": "refused", "right": told, "said": said, "parameters": [], "rival": "", "claims": 0,
                "held_out": None, "all": None}  # fmt: skip
    effects = report["effects"]
    errors = report["fit"]["holdout"].values()
    return {
        **facts,
        "verdict": report["verdict"],
        "right": _right(case, report),
        "named": [cause(effect) for effect in effects],
        "claims": len(effects),
        "parameters": [row for effect in effects for row in _parameters(case, effect)],
        "rival": _rival(effects),
        "held_out": max(error["rmse_after"] / error["noise_floor"] for error in errors),
        "all": max(error["rmse_after_all"] / error["noise_floor"] for error in errors),
        "said": " ".join(report["data_quality"]),
    }


def _right(case: Case, report: Mapping[str, Any]) -> bool:
    named = sorted(cause(effect) for effect in report["effects"])
    if case.kind == "clean":
        return report["verdict"] == "no_mismatch" and not named
    if not case.equation:
        return named == sorted(case.causes)
    modelled = report["verdict"] == "modelled"
    places = report["location"] if modelled else (report["remainder"] or {}).get("location", [])
    found = bool(places) and max(places, key=lambda place: place["share"])["equation"] == case.equation
    late = any("a row late" in sentence for sentence in report["data_quality"])
    return not named and found and late == (case.kind == "late")


def _parameters(case: Case, effect: Mapping[str, Any]) -> Iterable[dict[str, Any]]:
    truth = case.causes.get(cause(effect), {})
    for name, found in effect["parameters"].items():
        true = truth.get(name)
        interval = found["ci95"]
        holds = None if true is None else bool(interval) and interval[0] <= true <= interval[1]
        low, high = interval or (None, None)
        yield {"name": name, "value": found["value"], "low": low, "high": high, "true": true, "holds": holds}


def _rival(effects: Iterable[Mapping[str, Any]]) -> str:
    rivals = [rival for effect in effects for rival in effect["rivals"]]
    if not rivals:
        return ""
    nearest = min(rivals, key=lambda rival: rival["delta_bic"])
    return f"{nearest['id']} {nearest['delta_bic']:.0f}{'' if nearest['distinguishable'] else ' ='}"


def table(rows: Iterable[Mapping[str, Any]]) -> Table:
    """Rows for people; the summary is its title."""
    rows = list(rows)
    made = Table(COLUMNS, title=summary(rows))
    for row in rows:
        values = "; ".join(_shown(parameter) for parameter in row["parameters"])
        shown = {key: row[key] for key in ("case", "kind", "verdict", "rival", "seconds")}
        errors = {key: round(row[key], 3) if row[key] else float("nan") for key in ("held_out", "all")}
        made.add(**shown, **errors, right="yes" if row["right"] else "no", values=values)
    return made


def _shown(row: Mapping[str, Any]) -> str:
    interval = "" if row["low"] is None else f" [{row['low']:.5g}, {row['high']:.5g}]"
    true = "" if row["true"] is None else f" ({row['true']:.5g})"
    return f"{row['name']} {row['value']:.5g}{interval}{true}{' !' if row['holds'] is False else ''}"


def summary(rows: Iterable[Mapping[str, Any]]) -> str:
    """What was right, by kind, in one line."""
    rows = list(rows)
    parts = []
    for kind in dict.fromkeys(row["kind"] for row in rows):
        own = [row for row in rows if row["kind"] == kind]
        if kind == "clean":
            parts.append(f"claims on clean {sum(row['claims'] > 0 for row in own)} of {len(own)}")
            continue
        holds = [parameter["holds"] for row in own for parameter in row["parameters"] if parameter["true"] is not None]
        intervals = f" (intervals {sum(holds)} of {len(holds)})" if holds else ""
        parts.append(f"{kind} {sum(row['right'] for row in own)} of {len(own)}{intervals}")
    return "; ".join(parts)
