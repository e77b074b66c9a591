# SPDX-License-Identifier: Apache-2.0
"""Contraction filter: from one bench sample to one correction of the valve current; never raises on a sample.

    sample ──> Certificate ──> a, b ──> QpFilter ──> delta_u, status
                 Metric, Dynamics, Controller          bounds: remaining range of the valve

The bounds hold for the valve's current: sat(u_nom) + du within +-u_max. A nominal current beyond the limit is clipped
by the valve and no reason to correct.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite, nan
from typing import Annotated, NamedTuple

from hydro_bridge.settings import quantity
from hydro_bridge.signals import CorrectionStatus
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.certificate.qp import QpFilter
from hydro_filter.metric.constant import MetricDesign, constant_metric
from hydro_filter.model.dynamics import AnalyticDynamics
from hydro_filter.model.force_law import ForceLaw
from hydro_filter.model.sample import Sample
from hydro_filter.model.state import state_scale
from hydro_sim.model.bench import Bench


@dataclass(frozen=True, kw_only=True)
class FilterSettings:
    """Settings of the filter."""

    contraction_rate: Annotated[float, quantity("1/s", 0.0, 50.0)] = 0.1
    """lambda of the certificate; the paper's 0.1."""
    noise_floor: Annotated[float, quantity("N", 0.0, 100.0)] = 1.8
    """Force errors up to it are taken for noise; three standard deviations of the load cell."""
    state_age_max: Annotated[float, quantity("s", 0.001, 0.1)] = 5e-3
    """A state that is older, or stamped so far ahead, is not acted upon."""
    bypass: bool = False
    """Correct nothing and say so in every correction: status BYPASSED."""


class Result(NamedTuple):
    """Result of one sample."""

    delta_u: float
    """A, finite, 0 unless status is MODIFIED or RELAXED."""
    before: float
    """M_c [1/s] without the correction; NaN if it was not evaluated or not finite."""
    after: float
    """M_c [1/s] with it."""
    status: CorrectionStatus


class ContractionFilter:
    """Assembles certificate and QP. Never raises on a sample.

    Parameters
    ----------
    certificate
        Metric, model and law, with rate, noise floor and valve limit; `for_bench` makes the analytic one.
    settings
        Only age and bypass are used here; the others are part of the certificate.
    """

    @staticmethod
    def unknown(*, compensated: bool) -> str:
        """See `LoopFilter.unknown`."""
        return "the constant metric is for the paper's law" if compensated else ""

    mismatch = ""
    """It has no model to watch but the bench file's; see `LoopFilter.mismatch`."""

    def __init__(self, certificate: Certificate, settings: FilterSettings | None = None) -> None:
        self.certificate = certificate
        self.settings = settings or FilterSettings()
        self.qp = QpFilter()

    @classmethod
    def for_bench(
        cls, bench: Bench, settings: FilterSettings | None = None, design: MetricDesign | None = None
    ) -> ContractionFilter:
        """Create the filter of the analytic bench with its constant metric (raises as `loop_weight`)."""
        settings = settings or FilterSettings()
        certificate = Certificate(
            metric=constant_metric(bench, design),
            dynamics=AnalyticDynamics(bench),
            controller=ForceLaw(bench),
            scale=state_scale(bench),
            contraction_rate=settings.contraction_rate,
            noise_floor=settings.noise_floor,
            current_max=bench.valve_current_max,
        )
        return cls(certificate, settings)

    def reset(self) -> None:
        """Do nothing: this filter has no memory."""

    def skip(self) -> None:
        """Announce that samples are missing before the next one."""

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""
        if sample.compensated:
            return Result(0.0, nan, nan, CorrectionStatus.BYPASSED)
        if self.settings.bypass:
            before = -self.certificate.evaluate(sample).b
            return Result(0.0, before, before, CorrectionStatus.BYPASSED)
        if not abs(age) <= self.settings.state_age_max:
            return Result(0.0, nan, nan, CorrectionStatus.STALE)
        if not all(map(isfinite, (*sample.state, sample.nominal_current))):  # also in states that v ignores
            return Result(0.0, nan, nan, CorrectionStatus.NAN)
        line = self.certificate.evaluate(sample)
        limit = self.certificate.current_max
        applied = min(max(sample.nominal_current, -limit), limit)
        change, status = self.qp.solve(line.a, line.b, -limit - applied, limit - applied)
        if status is CorrectionStatus.NAN:
            return Result(0.0, -line.b, -line.b, status)
        # sat(u_nom + delta_u) = sat(u_nom) + change
        delta_u = change + (applied - sample.nominal_current) if change else 0.0
        return Result(delta_u, -line.b, line.value(change), status)
