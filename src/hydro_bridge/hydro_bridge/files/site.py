# SPDX-License-Identifier: Apache-2.0
"""A site: the folder of one bench, written by `commission`. Names of its files.

bench.yaml              what the box believes
corrected.yaml          what the bench is, as far as a diagnosis found
metric.safetensors      the filter's metric of it
recordings/, reports/   by gate
commission.json         which gates passed, causes, comparison; report.html beside it
"""

from __future__ import annotations

BENCH, MODEL, METRIC = "bench.yaml", "corrected.yaml", "metric.safetensors"
RECORDINGS, REPORTS = "recordings", "reports"
