# SPDX-License-Identifier: Apache-2.0
"""Statistics of the filter: counts of statuses, missing samples, durations."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from hydro_bridge.process.realtime import Latency
from hydro_bridge.signals import CorrectionStatus
from hydro_filter.certificate import QpCounts


@dataclass
class FilterStatistics:
    """Statistics since the node started; `news` compares with its previous call."""

    statuses: Counter[CorrectionStatus] = field(default_factory=Counter)
    missing: int = 0
    """Samples that never came, by gaps in the sequence."""
    work: Latency = field(default_factory=Latency)
    """From the callback's begin to the correction's publication."""
    age: Latency = field(default_factory=Latency)
    """From a sample's stamp to the publication of its correction."""
    _sequence: int | None = None
    _told: Counter[CorrectionStatus] = field(default_factory=Counter)

    def expect(self, sequence: int) -> bool:
        """Record a sample's sequence number, wrapping at 2^32; returns whether it follows the last one."""
        gap = -1 if self._sequence is None else (sequence - self._sequence - 1) & 0xFFFFFFFF
        self.missing += gap if 0 < gap < 0x80000000 else 0  # a restarted source counts from zero
        self._sequence = sequence
        return gap == 0

    def add(self, status: CorrectionStatus, work: float, age: float) -> None:
        """Count one correction; durations in s."""
        self.statuses[status] += 1
        self.work.add(work)
        self.age.add(age)

    def news(self) -> Counter[CorrectionStatus]:
        """Return the statuses since the last call."""
        fresh = self.statuses - self._told
        self._told = self.statuses.copy()
        return fresh

    def values(self, qp: QpCounts) -> dict[str, object]:
        """Return the values by name, for /diagnostics."""
        counts = {status.name.lower(): self.statuses[status] for status in CorrectionStatus}
        solver = {"qp_solved": qp.solved, "qp_infeasible": qp.infeasible, "qp_fallbacks": qp.fallbacks}
        return {
            **counts,
            "missing_states": self.missing,
            **solver,
            **_shown("work", self.work),
            **_shown("age", self.age),
        }


def sentence(news: Counter[CorrectionStatus]) -> str:
    """Return a sentence about the last second, worst first."""
    order = (
        CorrectionStatus.BYPASSED,
        CorrectionStatus.MISMATCH,
        CorrectionStatus.NAN,
        CorrectionStatus.STALE,
        CorrectionStatus.INFEASIBLE,
        CorrectionStatus.RELAXED,
        CorrectionStatus.MODIFIED,
    )
    parts = [f"{news[status]} {status.name.lower()}" for status in order if news[status]]
    total = sum(news.values())
    return f"{total} corrections" + (f": {', '.join(parts)}" if parts else "")


def _shown(name: str, latency: Latency) -> dict[str, object]:
    percentiles = (50.0, 99.0, 99.9)
    return {f"{name}_p{percent:g}_ms".replace(".", "_"): 1e3 * latency.percentile(percent) for percent in percentiles}
