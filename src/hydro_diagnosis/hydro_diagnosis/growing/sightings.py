# SPDX-License-Identifier: Apache-2.0
"""Sightings: the closures of reports, and the one law that all of them hold."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hydro_bridge.errors import UserError
from hydro_sim.model import grammar
from hydro_sim.model.laws import Law

FEWEST = 2
"""Benches on which a law must have been found."""


@dataclass(frozen=True)
class Estimate:
    """A number of a law on one bench."""

    value: float
    low: float | None
    """Ends of the 95 % interval; None where the recordings did not identify the number."""
    high: float | None


@dataclass(frozen=True)
class Sighting:
    """A law as one diagnosis found it."""

    report: str
    """Path of the report, as it was given."""
    law: Law
    estimates: Mapping[str, Estimate]
    """By the law's parameters."""


def units(law: Law) -> dict[str, str]:
    """Units of a law's parameters, by name."""
    return {"coefficient": law.unit, **{number.name: number.unit for number in law.numbers}}


def sightings(reports: Sequence[str | Path], form: str | None = None) -> list[Sighting]:
    """The law that all reports hold, as each of them found it.

    Parameters
    ----------
    reports
        report.json of diagnoses, or the folders that hold them.
    form
        Name of the law, where the reports have several in common.

    Raises
    ------
    UserError
        Reports that are too few, of the same recordings, unreadable, without a closure, or without a law in common.
    """
    contents = [(str(report), _read(Path(report))) for report in reports]
    _refuse_twins(contents)
    if len(contents) < FEWEST:
        raise UserError(
            f"one report is one bench: a law must have been found on {FEWEST} at least before it becomes an effect"
        )
    found = [_laws(report, content) for report, content in contents]
    shared = [name for name in found[0] if all(name in one for one in found)]
    chosen = [name for name in shared if form is None or name[1] == form]
    if not shared:
        raise UserError("the reports hold different laws: " + "; ".join(_told(one) for one in found))
    if len(chosen) != 1:
        names = ", ".join(repr(name[1]) for name in shared)
        why = "the reports have several laws in common" if form is None else f"the reports do not share a law {form!r}"
        raise UserError(f"{why}: choose by --law one of {names}")
    return [one[chosen[0]] for one in found]


_Laws = dict[tuple[str, str], Sighting]
"""By equation and form."""


def _read(path: Path) -> Mapping[str, Any]:
    path = path / "report.json" if path.is_dir() else path
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError):
        content = None
    if not isinstance(content, dict) or not {"verdict", "closures", "recordings"} <= set(content):
        raise UserError(f"{path} is no report.json of a diagnosis")
    return content


def _refuse_twins(contents: Sequence[tuple[str, Mapping[str, Any]]]) -> None:
    seen: dict[str, str] = {}
    for report, content in contents:
        key = json.dumps([content["recordings"], content["closures"]], sort_keys=True)
        if key in seen:
            raise UserError(f"{seen[key]} and {report} are one diagnosis: reports of different benches are meant")
        seen[key] = report


def _laws(report: str, content: Mapping[str, Any]) -> _Laws:
    """Laws of one report."""
    if not content["closures"]:
        raise UserError(f"{report} has no closure (its verdict is {content['verdict']}): there is no law to grow from")
    laws = [one for one in content["closures"] if one["form"] == "law"]
    if not laws:
        places = ", ".join(one["equation"] for one in content["closures"])
        raise UserError(f"{report} has a smooth function in {places}, not a law: a table of numbers is no effect")
    found = [_sighting(report, one) for one in laws]
    return {(one.law.equation, one.law.form): one for one in found}


_LAWS = (*grammar.LAWS, *grammar.COMPOSITIONS, *grammar.ROUNDED)


def _sighting(report: str, closure: Mapping[str, Any]) -> Sighting:
    """The law of the grammar that an entry of `closures` was written from, with its numbers."""
    written = str(closure["expression"]).partition(" * ")[2]
    for law in _LAWS:
        same = law.equation == closure["equation"] and law.names == tuple(closure["terms"])
        same = same and (
            law.equation != "sensor" or law.sentence == closure["sentence"]
        )  # which says whose sensor it is
        further = f", {law.numbers[0].name} = " if law.numbers else ""
        if same and (written == law.text or (further and written.startswith(law.text + further))):
            return Sighting(report, law, {name: _estimate(one) for name, one in closure["terms"].items()})
    raise UserError(f"{report}: the law {written!r} is none of this version's: diagnose its recordings again")


def _estimate(term: Mapping[str, Any]) -> Estimate:
    low, high = term["ci95"] or (None, None)
    return Estimate(float(term["value"]), low, high)


def _told(laws: _Laws) -> str:
    names = " and ".join(f"{form} ({equation})" for equation, form in laws)
    return f"{next(iter(laws.values())).report} has {names}"
