# SPDX-License-Identifier: Apache-2.0
"""What a diagnosis hands to the pages that show it: the findings, and what they were made from."""

from __future__ import annotations

from dataclasses import dataclass, field

from hydro_diagnosis.model import SegmentModel
from hydro_diagnosis.outcome import Outcome
from hydro_diagnosis.problem import Problem
from hydro_diagnosis.report import Report
from hydro_diagnosis.verdict import Assessment
from hydro_sim.bench import Bench


@dataclass
class Diagnosis:
    """A report and what it was made from."""

    report: Report
    bench: Bench
    problem: Problem
    assessment: Assessment
    outcome: Outcome
    holdout: list[SegmentModel] = field(default_factory=list)
