# SPDX-License-Identifier: Apache-2.0
"""Result of a diagnosis: the report with its underlying data, as text, table and corrected bench."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING

from hydro_diagnosis.bench_parameters import PartialBench
from hydro_diagnosis.effects.base import display_unit
from hydro_diagnosis.recording import HELD_THIRD_NOTE
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.report_json import Report, row_of
from hydro_diagnosis.simulator_comparison import sentences
from hydro_diagnosis.stage_border import StageBorder
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    import pandas as pd

    from hydro_diagnosis.estimation.problem import Problem
    from hydro_diagnosis.judge import Assessment
    from hydro_diagnosis.model.segment_model import SegmentModel
    from hydro_diagnosis.selection.search import SearchOutcome


def interval(ci95: Sequence[float] | None, factor: float = 1.0) -> str:
    """Return a 95 % confidence interval as text; `factor`: unit conversion by `display_unit`."""
    if ci95 is None:
        return "not identifiable from these recordings"
    low, high = ci95[0] * factor, ci95[1] * factor
    digits = 5  # or as many as tell its ends apart
    while digits < 15 and low < high and f"{low:.{digits - 1}g}" == f"{high:.{digits - 1}g}":
        digits += 1
    return f"95 % {low:.{digits}g} to {high:.{digits}g}"


def accounted_sentence(report: Report) -> str:
    """Sentence on the shares of the held-out mismatch that the effects account for; empty without a mismatch."""
    what = {
        "pressure_a": "flow of chamber A", "pressure_b": "flow of chamber B", "actuation": "valve's flow",
        "motion": "force on the moving mass", "load": "force of the load", "sensor": "sum of the pressures' forces",
    }  # fmt: skip
    said = []
    for equation, shares in report.accounted.items():
        named, everything = (100.0 * max(shares[key], 0.0) for key in ("named", "all"))
        further = f" ({everything:.0f} % with terms that have no name)" if everything - named > 1.0 else ""
        said.append(f"{named:.0f} % of the {what[equation]} that your simulation misses{further}")
    return f"On what was held out, the names account for {', and '.join(said)}." if said else ""


@dataclass(repr=False)
class Diagnosis:
    """Result of a diagnosis: the report, with its estimation problem, fits and held-out segments."""

    report: Report
    bench: Bench
    problem: Problem
    assessment: Assessment
    outcome: SearchOutcome
    holdout: list[SegmentModel] = field(default_factory=list)
    border: StageBorder = field(default_factory=StageBorder)
    """Lost stages, with their tracebacks."""

    def __str__(self) -> str:
        """Return the result as text, as printed by `diagnose`."""
        report, lines = self.report, [f"verdict: {self.report.verdict}", f"  {self.used}"]
        lines += [f"  {one.sentence}" for one in report.lost]
        if accounted := accounted_sentence(report):
            lines.append(f"  {accounted}")
        lines += [f"  {answer}" for answer in report.answers]
        lines += [f"forecast: {one.sentence}" for one in report.forecast or ()]
        for effect in report.effects:
            lines.append(f"  {effect.id}: {effect.sentence}")
            for name, estimate in effect.parameters.items():
                unit, factor = display_unit(estimate.unit)
                value = f"{estimate.value * factor:.5g} {unit}".strip()
                lines.append(f"    {name} = {value} ({interval(estimate.ci95, factor)})")
        if report.simulated is not None:
            lines.append(
                "bench and simulator: "
                + ("by these they differ" if report.simulated else "no difference that these recordings tell")
            )
            lines += [f"  {sentence}" for sentence in sentences(report.simulated)]
        lines += [f"  {number.sentence}" for number in report.estimated]
        for closure in report.closures:
            lines.append(f"  without a name, in {closure.equation}: {closure.expression}")
            lines.append(f"    {closure.sentence}")
        if report.closures:
            closed = 100.0 * report.closures[0].share_closed
            lines.append(f"  terms without a name together close {closed:.3g} % of the gap that names leave held out")
        if report.remainder:
            places = ", ".join(place["equation"] for place in report.remainder["location"])
            depends = ", ".join(report.remainder["depends_on"]) or "none of the variables tried"
            lines.append(f"  unexplained: part of {places}; it depends on {depends}")
            lines += [f"  {likeness}" for likeness in report.remainder["looks_like"]]
        return "\n".join([*lines, *(f"  note: {note}" for note in report.data_quality)])

    __repr__ = __str__

    @property
    def used(self) -> str:
        """Sentence on the fitted and the held-out recordings, with their durations."""
        fitted, checked = dict[str, float](), dict[str, float]()
        for models, lengths in ((self.problem.models, fitted), (self.holdout, checked)):
            for segment in (model.segment for model in models):
                lengths[segment.recording] = lengths.get(segment.recording, 0.0) + len(segment) * segment.step
        if HELD_THIRD_NOTE in self.report.data_quality:
            (name, first), last = next(iter(fitted.items())), sum(checked.values())
            return f"fitted on two thirds of {name} ({first:.4g} s); checked on the other third ({last:.4g} s)"
        said = (", ".join(f"{name} ({length:.4g} s)" for name, length in one.items()) for one in (fitted, checked))
        return "fitted on {}; checked on {}".format(*said)

    @property
    def corrected(self) -> Bench:
        """Corrected bench, as in corrected.yaml; an estimated parameter is replaced only if it is identified."""
        unidentified = [one for one in self.report.estimated if one.ci95 is None]
        given = {one.name: one.given for one in unidentified if one.given is not None}
        missing = frozenset(one.name for one in unidentified if one.given is None)
        bench = replace(corrected_bench(self.bench, self.assessment.fit.claims), **given)  # type: ignore[arg-type]
        return replace(bench, unknown=bench.unknown | missing) if isinstance(bench, PartialBench) else bench

    @property
    def table(self) -> pd.DataFrame:
        """Claimed effects as a table: a row per effect and parameter, with value and 95 % interval in `unit`."""
        import pandas as pd

        rows = [
            {"effect": " ".join([effect.id, *effect.options.values()]), "parameter": name, **row_of(one)}
            for effect in self.report.effects
            for name, one in effect.parameters.items()
        ]
        columns = ["effect", "parameter", "value", "low", "high", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index(["effect", "parameter"])

    def _repr_html_(self) -> str:
        """Show report.html in a notebook."""
        from hydro_diagnosis.report.page import render_report

        return f'<iframe srcdoc="{escape(render_report(self))}" style="width: 100%; height: 40em; border: 0"></iframe>'
