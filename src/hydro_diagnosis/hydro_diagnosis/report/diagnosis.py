# SPDX-License-Identifier: Apache-2.0
"""Input of the report pages: the findings, and the data behind them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING

from hydro_diagnosis.bench_numbers import PartialBench
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.findings import Report
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.report.corrected_bench import corrected_bench
from hydro_diagnosis.selection.outcome import Outcome
from hydro_diagnosis.selection.verdict import Assessment
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    import pandas as pd


@dataclass
class Diagnosis:
    """A report and the data behind it."""

    report: Report
    bench: Bench
    problem: Problem
    assessment: Assessment
    outcome: Outcome
    holdout: list[SegmentModel] = field(default_factory=list)
    notes: tuple[str, ...] = ()
    """What the verdict does not say, of `data_quality` what is not about the data alone."""

    @property
    def corrected(self) -> Bench:
        """The bench with what was found, as in corrected.yaml: an estimated number only if the recordings tell it."""
        unidentified = [one for one in self.report.estimated if one.ci95 is None]
        given = {one.name: one.given for one in unidentified if one.given is not None}
        missing = frozenset(one.name for one in unidentified if one.given is None)
        bench = replace(corrected_bench(self.bench, self.assessment.fit.claims), **given)  # type: ignore[arg-type]
        return replace(bench, unknown=bench.unknown | missing) if isinstance(bench, PartialBench) else bench

    @property
    def table(self) -> pd.DataFrame:
        """The claims: a row per parameter, indexed by effect, with its value in `unit` and its 95 % interval."""
        import pandas as pd

        rows = [
            {
                "effect": " ".join([effect.id, *effect.options.values()]),
                "parameter": name,
                "value": one.value,
                "low": None if one.ci95 is None else one.ci95[0],
                "high": None if one.ci95 is None else one.ci95[1],
                "unit": one.unit,
            }
            for effect in self.report.effects
            for name, one in effect.parameters.items()
        ]
        columns = ["effect", "parameter", "value", "low", "high", "unit"]
        return pd.DataFrame(rows, columns=columns).set_index(["effect", "parameter"])

    def _repr_html_(self) -> str:
        """Show report.html in a notebook."""
        from hydro_diagnosis.report.page import rendered

        return f'<iframe srcdoc="{escape(rendered(self))}" style="width: 100%; height: 40em; border: 0"></iframe>'
