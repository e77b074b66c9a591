# SPDX-License-Identifier: Apache-2.0
"""`diagnose --grow`: a law that diagnoses found on several benches becomes a named effect.

The law common to all reports is read from their closures, its parameters are compared, and the effect is written.

Cochran's Q: squared deviations from the mean, which is weighted by the inverse variances, over these variances; of
equal values it follows chi-squared. Source: Cochran 1954, The combination of estimates from different experiments.
"""

from __future__ import annotations

import argparse
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import nan
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from scipy.stats import chi2

from hydro_core.cli.console import Table
from hydro_core.errors import UserError
from hydro_core.files.atomic import write_atomic
from hydro_diagnosis.effects import CANDIDATES
from hydro_diagnosis.report_json import ParameterEstimate
from hydro_diagnosis.significance import CONFIDENCE, QUANTILE
from hydro_sim.model import grammar
from hydro_sim.model.effects import grown
from hydro_sim.model.effects.catalogue import KINDS
from hydro_sim.model.laws import Law


@dataclass(frozen=True)
class ParameterAgreement:
    """Agreement of one parameter of a law over the benches."""

    name: str
    unit: str
    common: float
    """Weighted mean; the median if one value does not fit, or fewer than two benches identify the parameter."""
    ci95: tuple[float, float] | None = None
    """95 % interval of the weighted mean; None if fewer than two benches identify the parameter."""
    probability: float | None = None
    """Probability of deviations as large as these if one value holds for all; None likewise."""

    @property
    def consistent(self) -> bool:
        """Whether one value is consistent with all benches: Cochran's Q has a probability of 5 % or more."""
        return self.probability is not None and self.probability >= 2.0 * (1.0 - CONFIDENCE)

    @property
    def sentence(self) -> str:
        """Agreement as a sentence, for the command and for the effect's file."""
        if self.probability is None or self.ci95 is None:
            return f"{self.name}: too few benches identify it to compare its values."
        if not self.consistent:
            return f"{self.name}: each bench has its own value ({_probability(self.probability)} for one value)."
        interval = "{:.4g} to {:.4g}".format(*self.ci95)
        return (
            f"{self.name}: one value fits all benches, {self.common:.4g} {self.unit} (95 % {interval}, "
            f"{_probability(self.probability)})."
        )


def parameter_agreements(found: Sequence[LawEstimate]) -> list[ParameterAgreement]:
    """Return the agreement of each parameter of the law, in the law's order."""
    agreed = []
    for name, unit in law_units(found[0].law).items():
        estimates = [one.estimates[name] for one in found]
        known = [(one.value, *one.ci95) for one in estimates if one.ci95]
        if len(known) < 2:
            agreed.append(ParameterAgreement(name, unit, float(np.median([one.value for one in estimates]))))
            continue
        values, lows, highs = np.array(known).T
        weights = np.square(2.0 * QUANTILE / np.maximum(highs - lows, 1e-12 * np.abs(values)))
        mean = float(weights @ values / weights.sum())
        reach = QUANTILE / float(np.sqrt(weights.sum()))
        deviation = float(weights @ np.square(values - mean))
        probability = float(chi2.sf(deviation, len(known) - 1))
        common = mean if probability >= 2.0 * (1.0 - CONFIDENCE) else float(np.median(values))
        agreed.append(ParameterAgreement(name, unit, common, (mean - reach, mean + reach), probability))
    return agreed


def _probability(value: float) -> str:
    least = 1e-6  # smallest probability that is printed
    return f"p = {value:.2g}" if value >= least else f"p < {least:g}"


@dataclass(frozen=True)
class LawEstimate:
    """Law with the parameters estimated by one diagnosis."""

    report: str
    """Path of the report, as it was given."""
    law: Law
    estimates: Mapping[str, ParameterEstimate]
    """Estimates by name of the law's parameter."""


def law_units(law: Law) -> dict[str, str]:
    """Units of a law's parameters, by name."""
    return {"coefficient": law.unit, **{one.name: one.unit for one in law.shape_parameters}}


def law_estimates(reports: Sequence[str | Path], form: str | None = None) -> list[LawEstimate]:
    """Return the law that all reports share, with the parameters that each diagnosis estimated.

    `reports`: report.json of diagnoses, or the folders that hold them. `form`: name of the law, where the reports have
    several in common. Raises UserError: reports that are too few, of the same recordings, unreadable, without a
    closure, or without a law in common.
    """
    contents = [(str(report), _read(Path(report))) for report in reports]
    seen: dict[str, str] = {}
    for report, content in contents:
        key = json.dumps([content["recordings"], content["closures"]], sort_keys=True)
        if key in seen:
            raise UserError(f"{seen[key]} and {report} are one diagnosis: give reports of different benches")
        seen[key] = report
    if len(contents) < 2:
        raise UserError("one report is one bench: a law must have been found on 2 at least before it becomes an effect")
    found = [_laws(report, content) for report, content in contents]
    shared = [name for name in found[0] if all(name in one for one in found)]
    chosen = [name for name in shared if form is None or name[1] == form]
    if not shared:
        laws = (" and ".join(f"{form} ({equation})" for equation, form in one) for one in found)
        held = (f"{report} has {names}" for (report, _), names in zip(contents, laws, strict=True))
        raise UserError("the reports hold different laws: " + "; ".join(held))
    if len(chosen) != 1:
        names = ", ".join(repr(name[1]) for name in shared)
        why = "the reports have several laws in common" if form is None else f"the reports do not share a law {form!r}"
        raise UserError(f"{why}: choose by --law one of {names}")
    return [one[chosen[0]] for one in found]


def _read(path: Path) -> Mapping[str, Any]:
    path = path / "report.json" if path.is_dir() else path
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, json.JSONDecodeError):
        content = None
    if not isinstance(content, dict) or not {"verdict", "closures", "recordings"} <= set(content):
        raise UserError(f"{path} is not a report.json of a diagnosis")
    return content


def _laws(report: str, content: Mapping[str, Any]) -> dict[tuple[str, str], LawEstimate]:
    """Laws of one report by equation and form: those of the grammar from which `closures` were written."""
    if not content["closures"]:
        raise UserError(f"{report} has no closure (its verdict is {content['verdict']}): there is no law to grow from")
    laws = [one for one in content["closures"] if one["form"] == "law"]
    if not laws:
        places = ", ".join(one["equation"] for one in content["closures"])
        raise UserError(f"{report} has a smooth function in {places}, not a law: a table of numbers is not an effect")
    found = {}
    for closure in laws:
        written, terms = str(closure["expression"]).partition(" * ")[2], closure["terms"]
        for law in (*grammar.LAWS, *grammar.LAWS_WITH_REVERSAL_VELOCITY):
            same = law.equation == closure["equation"] and law.names == tuple(terms)
            same = same and (law.equation != "sensor" or law.sentence == closure["sentence"])  # says whose sensor it is
            further = f", {law.shape_parameters[0].name} = " if law.shape_parameters else ""
            if same and (written == law.text or (further and written.startswith(law.text + further))):
                numbers = {name: ParameterEstimate(**one) for name, one in terms.items()}
                found[law.equation, law.form] = LawEstimate(report, law, numbers)
                break
        else:
            raise UserError(f"{report}: the law {written!r} is none of this version's: diagnose its recordings again")
    return found


# --- the effect -------------------------------------------------------------------------------------------------------


def write_law_effect(found: Sequence[LawEstimate], agreed: Sequence[ParameterAgreement], path: Path) -> None:
    """Write a law as an effect file, in the format of `hydro_sim.model.effects.grown`."""
    law = found[0].law
    about = [f'Grown by `diagnose --grow` from the law "{law.form}" ({law.equation}), found on {len(found)} benches.',
             *(one.sentence for one in agreed)]  # fmt: skip
    numbers = {}
    reach = 10.0  # factor from the extreme estimates to the parameter's bounds, on the same side of 0
    for one in agreed:
        seen = [sighting.estimates[one.name] for sighting in found]
        ends = [end for estimate in seen for end in (estimate.value, *(estimate.ci95 or ()))]
        low, high = min(ends), max(ends)
        near = 0.0 if one.name == "coefficient" else 1.0 / reach
        if low < 0.0 < high:
            low, high = -reach * max(-low, high), reach * max(-low, high)
        else:
            low, high = low * (near if low > 0.0 else reach), high * (reach if high > 0.0 else near)
        # four digits: more were not seen
        rounded = {"seen": one.common, "low": low, "high": high}
        numbers[one.name] = {key: float(f"{value:.4g}") + 0.0 for key, value in rounded.items()}
    content = {"law": {"equation": law.equation, "form": law.form}, "sentence": law.sentence, "parameters": numbers}
    text = "".join(f"# {line}".rstrip() + "\n" for line in about)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(path, (text + yaml.safe_dump(content, sort_keys=False, width=110)).encode())


def grow(chosen: argparse.Namespace) -> int:
    """Compare the reports, write the effect and print the agreement; `chosen`: options of `cli.parser`."""
    folder = chosen.out or grown.target_folder()
    path = folder / f"{chosen.id}.yaml"
    if not re.fullmatch(r"[a-z][a-z0-9]*(_[a-z0-9]+)*", chosen.id):
        raise UserError(f"--id {chosen.id!r}: use lower-case words joined by _, for instance port_drag")
    if chosen.id in {one.split()[0] for one in KINDS} | {one.id for one in CANDIDATES}:
        raise UserError(f"--id {chosen.id}: an effect of this id exists: choose another name")
    if path.exists():
        raise UserError(f"{path} exists: choose another --id")
    found = law_estimates(chosen.reports, chosen.law)
    agreed = parameter_agreements(found)
    write_law_effect(found, agreed, path)
    law = found[0].law
    table = Table(
        {"report": "", "parameter": "", "value": "SI, in the unit beside it", "low": "of the 95 % interval", "high": "",
         "unit": ""},
        title=f"{law.form} ({law.equation}): {law.text}",
    )  # fmt: skip
    for name, unit in law_units(law).items():
        for one in found:
            estimate = one.estimates[name]
            low, high = estimate.ci95 or (nan, nan)
            table.add(report=one.report, parameter=name, value=estimate.value, low=low, high=high, unit=unit)
    table.show(chosen.json)
    print(f"\n{chosen.id}: {law.sentence}")
    for agreement in agreed:
        print(f"  {agreement.sentence}")
    print(f"{path} is the effect")
    if not grown.is_searched(folder):
        print(f"bench files may name it where {grown.FOLDER_VARIABLE}={folder} is set")
    return 0
