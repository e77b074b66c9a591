# SPDX-License-Identifier: Apache-2.0
"""Input of the report pages: the findings, and the data behind them."""

from __future__ import annotations

from dataclasses import dataclass, field

from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.findings import Report
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.selection.outcome import Outcome
from hydro_diagnosis.selection.verdict import Assessment
from hydro_sim.model.bench import Bench


@dataclass
class Diagnosis:
    """A report and the data behind it."""

    report: Report
    bench: Bench
    problem: Problem
    assessment: Assessment
    outcome: Outcome
    holdout: list[SegmentModel] = field(default_factory=list)
