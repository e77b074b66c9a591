# SPDX-License-Identifier: Apache-2.0
"""Counts for /diagnostics."""

from __future__ import annotations

from hydro_bridge.signals import CorrectionStatus
from hydro_filter.certificate.qp import QpCounts
from hydro_filter.controller.statistics import FilterStatistics, sentence


def test_gaps_are_counted_across_the_wrap_and_restarts_are_none() -> None:
    tally = FilterStatistics()
    for sequence in (2**32 - 2, 2**32 - 1, 0, 3):
        tally.expect(sequence)
    assert tally.missing == 2
    tally.expect(1)  # a source that began anew
    assert tally.missing == 2


def test_news_are_what_happened_since_the_last_time() -> None:
    tally = FilterStatistics()
    for status in (CorrectionStatus.PASS, CorrectionStatus.PASS, CorrectionStatus.STALE):
        tally.add(status, 1e-5, 1e-3)
    assert sentence(tally.news()) == "3 corrections: 1 stale"
    assert not tally.news()
    tally.add(CorrectionStatus.MODIFIED, 1e-5, 1e-3)
    assert sentence(tally.news()) == "1 corrections: 1 modified"


def test_values_name_every_status_and_percentile() -> None:
    tally = FilterStatistics()
    for k in range(1000):
        tally.add(CorrectionStatus.PASS, 1e-6 * k, 2e-6 * k)
    values = tally.values(QpCounts(fallbacks=2))
    assert {status.name.lower() for status in CorrectionStatus} <= set(values)
    assert values["pass"] == 1000
    assert values["qp_fallbacks"] == 2
    assert abs(float(str(values["work_p99_ms"])) - 0.99) < 0.002
    assert abs(float(str(values["age_p50_ms"])) - 1.0) < 0.002
