# SPDX-License-Identifier: Apache-2.0
"""The contraction filter as an object, for the node; its decision is that of firmware/hydro/loop_filter.h.

::

    contraction_filter = default_filter(bench)
    contraction_filter.correct(sample)                    Sample in, Result out, one bench, as the node runs it
    records.decide(address, record, memory, ...)          the same for a compiled loop

The law is represented by f_c, f_c', C_1, C_2 (`hydro_filter.model.sample.Sample.law_inputs`). v is relative to f_r even
if the law follows f_c: the loop's contraction does not depend on the reference.

Samples must be consecutive: the memory simulates the spool from their currents. A correction acts one sample after its
own. Certified gains and limits: filter.md.

`LoopFilter` also monitors whether the model still fits the bench (firmware/hydro/monitor.h); if not, every result is
MISMATCH without a correction. A compiled loop does not: its benches are simulated, by that model or deliberately by
others.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, NamedTuple

import numpy as np

from hydro_core.settings import check, described, quantity
from hydro_core.signals import SAMPLE_PERIOD, CorrectionStatus
from hydro_core.valve_overlap import valve_overlap
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import coordinate_names, make_loop
from hydro_filter.model.records import (
    DECISION_DTYPE,
    FILTER_DTYPE,
    SAMPLE_DTYPE,
    library,
    make_record,
    new_memories,
    new_monitors,
)
from hydro_filter.model.sample import Sample
from hydro_sim.box.firmware import RecordArray, address_of
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import NOMINAL, Bench

EQUATIONS = {
    "load": "the spring or its load cell",
    "motion": "mass, friction or spring",
    "hydraulic force": "the piston's area or the load cell of f_h",
    "chamber a": "valve, supply, oil or area",
    "chamber b": "valve, supply, oil or area",
}
"""Equations of the model monitor, with what a violation of each is suspected of."""


@dataclass(frozen=True, kw_only=True)
class LoopFilterSettings:
    """Settings of the filter."""

    contraction_rate: Annotated[float, quantity("1/s", 0.0, 10.0, "lambda for certified gains; the paper's 0.1")] = 0.1
    foreign_rate: Annotated[
        float, quantity("1/s", 0.0, 15.0, "lambda of all other gains, whose loop the correction closes")
    ] = 8.0
    noise_share: Annotated[
        float, quantity("-", 0.0, 100.0, "Share of the metric's noise level that is ignored; 0: correct noise, too")
    ] = 1.0
    innovation_limit: Annotated[
        float, quantity("-", 0.3, 10.0, "Factor on the prediction error beyond which the model is not trusted")
    ] = 1.0
    state_age_max: Annotated[float, quantity("s", 0.001, 0.1, "States older, or that far ahead, are ignored")] = 5e-3
    bypass: Annotated[bool, described("Correct nothing and say so in every correction: status BYPASSED")] = False
    solver: Annotated[
        Literal["closed_form", "osqp"], described("Solver of this node; a box's own filter has the closed form")
    ] = "closed_form"

    def __post_init__(self) -> None:
        check(self)


class Result(NamedTuple):
    """Result of one sample."""

    delta_u: float
    """A, finite, 0 unless status is MODIFIED or RELAXED."""
    before: float
    """M_c [1/s] without the correction; NaN if it was not evaluated or not finite."""
    after: float
    """M_c [1/s] with the correction."""
    status: CorrectionStatus

    @classmethod
    def uncorrected(cls, status: CorrectionStatus) -> Result:
        """Return a result with zero correction, its certificate not evaluated (NaN)."""
        return cls(0.0, math.nan, math.nan, status)


STATUSES = tuple(CorrectionStatus)


class LoopFilter:
    """Contraction filter of one bench; `correct` never raises.

    Parameters
    ----------
    record
        Record of `filter_record` for the metric's C_1.
    settings
        Age, bypass, `innovation_limit` and solver are read here; the others are part of `record`.
    others
        Records for other C_1.
    """

    def __init__(
        self, record: RecordArray, settings: LoopFilterSettings | None = None, others: Sequence[RecordArray] = ()
    ) -> None:
        self.record = record
        self.settings = settings or LoopFilterSettings()
        self.solver = None
        """OSQP in place of the closed form; None: the closed form."""
        if self.settings.solver == "osqp":
            from hydro_filter.controller.osqp_solver import OsqpSolver  # not to wait for it where it is not used

            self.solver = OsqpSolver()
        self.memory, self.monitor = new_memories(), new_monitors()
        self.decision = np.zeros(1, DECISION_DTYPE)
        """Decision on the last sample, with a, b, low, high of its QP."""
        self._sample = np.zeros(1, SAMPLE_DTYPE)
        self._bytes, self._judge = self._sample.view(np.uint8).data, library().hydro_c_filter_judge
        self._records = (record, *others)  # have to live as long as their addresses
        self._certificates = [(float(each["velocity_compensation"][0]), address_of(each)) for each in self._records]
        """C_1 and address of each record."""
        papers = [c_1 == 1.0 for c_1, _ in self._certificates]
        self._unknown = [True not in papers, False not in papers]
        """Whether there is no certificate under the paper's law, and under the compensated one."""
        self._addresses = tuple(map(address_of, (self.memory, self.monitor, self._sample, self.decision)))

    @property
    def mismatch(self) -> str:
        """Message on the model equation whose residual is too large for this bench; empty while none is."""
        if not (broken := int(self.monitor["broken"][0])):
            return ""
        name, suspects = list(EQUATIONS.items())[broken - 1]
        return f"the model's {name} ({suspects}) is off by {self.monitor['ratio'][0]:.1f} times what is allowed"

    def missing_certificate(self, *, compensated: bool) -> str:
        """Return a message if there is no certificate under the compensated law, or the paper's; empty if there is."""
        if not self._unknown[compensated]:
            return ""
        law = (
            "compensated law: `learn_metric --model FILE.yaml` makes one of a bench file"
            if compensated
            else "paper's law"
        )
        return f"its metric is not made for the {law}"

    def reset(self) -> None:
        """Reset to the initial state."""
        self.reset_history()
        self.monitor["broken"] = 0

    def reset_history(self) -> None:
        """Discard the history after a gap in the samples; the verdict on the model is kept."""
        self.memory[:] = np.zeros(1, self.memory.dtype)
        for name in ("seen", "held", "sums", "runs"):
            self.monitor[name] = 0

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""
        if self._unknown[sample.compensated]:
            self.reset_history()
            return Result.uncorrected(CorrectionStatus.BYPASSED)
        law, (_, record) = sample.law_inputs, self._certificates[0]
        for c_1, address in self._certificates[1:]:
            if abs(law[2] - law[3] * c_1) <= 1e-3 * law[3]:
                record = address  # within HYDRO_SAME
        _PACK_SAMPLE(
            self._bytes, 0, *sample.state.tolist(), sample.nominal_current, sample.valve_current,
            sample.reference_force, sample.reference_rate, sample.proportional_gain, *law, sample.armed,
        )  # fmt: skip
        self._judge(record, self.settings.innovation_limit, *self._addresses)  # an old sample, too: the memory moves on
        delta_u, before, after, *_, status, _ = self.decision.item()
        if status == CorrectionStatus.NAN:
            before = math.nan
        if self.settings.bypass:
            return Result(0.0, before, before, CorrectionStatus.BYPASSED)
        if status == CorrectionStatus.NAN:
            return Result.uncorrected(CorrectionStatus.NAN)
        if self.monitor["broken"][0]:  # a certificate of another bench says nothing
            return Result.uncorrected(CorrectionStatus.MISMATCH)
        if not abs(age) <= self.settings.state_age_max:
            return Result.uncorrected(CorrectionStatus.STALE)
        if not sample.armed:
            return Result(0.0, 0.0, 0.0, CorrectionStatus.PASS)
        if self.solver is not None and status == CorrectionStatus.MODIFIED:
            return self._solve(Result(delta_u, before, after, CorrectionStatus.MODIFIED), sample.nominal_current)
        return Result(delta_u, before, after, STATUSES[status])

    def _solve(self, result: Result, nominal_current: float) -> Result:
        """Return the result with OSQP's correction; NAN if OSQP does not solve the program.

        OSQP is asked where the program has a solution other than 0: a correction of status RELAXED is none of it. M_c
        with the correction remains that of the closed form.
        """
        a, b, low, high = self.decision[["a", "b", "low", "high"]].item()
        change = self.solver.solve(a, b, low, high) if self.solver is not None else math.nan
        if not math.isfinite(change):
            return Result.uncorrected(CorrectionStatus.NAN)
        return result._replace(delta_u=change - (0.5 * (low + high) + nominal_current))


_PACK_SAMPLE = struct.Struct("17d?").pack_into
"""Writes a record of SAMPLE_DTYPE, three times as fast as by its fields' names."""


def loop_filter(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> LoopFilter:
    """Build the contraction filter from a scheduled metric and the others of its file, one for each value of C_1.

    Raises as `filter_record`.
    """
    first, *others = (filter_record(each, model, bench, settings) for each in metric.all_metrics)
    return LoopFilter(first, settings, others)


def filter_record(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> RecordArray:
    """Return a record of FILTER_DTYPE, shape (1,): of a metric, its training model, and the bench assumed by the box.

    Raises ValueError: the metric's coordinates are not those of the model's loop, or as `make_loop`.
    """
    settings, levels, loop = settings or LoopFilterSettings(), metric.thresholds, make_loop(model, bench)
    force, pressure, length, current = (
        getattr(bench.size, name) / getattr(NOMINAL, name) for name in ("force", "pressure", "length", "current")
    )
    # a plausible sample, far beyond the sensors' ranges [N, N/s, A, Pa; m, m/s]
    force, rate, current, p_max = force * 1e5, force * 1e9, current * 1e4, pressure * 1e8
    x_max = force, rate, force, rate, p_max, p_max, length * 1.0, length * 20.0
    if metric.coordinates != (needed := coordinate_names(loop)):
        raise ValueError(
            f"the metric is of the coordinates {', '.join(metric.coordinates)}, this model's loop has "
            f"{', '.join(needed)}: make one with `ros2 run hydro_filter learn_metric --model`"
        )
    values = {f"loop.{name}": value for name, value in loop.values.items()}
    values |= metric.firmware_fields | valve_overlap(model.effects)
    values |= {
        "kept": math.exp(-2.0 * settings.contraction_rate * SAMPLE_PERIOD),
        "foreign_kept": math.exp(-2.0 * settings.foreign_rate * SAMPLE_PERIOD),
        "noise_size": settings.noise_share * levels.noise_size,
        "foreign_noise_size": settings.noise_share * levels.foreign_noise_size,
        "integral_allowance": levels.integral_allowance,
        "most": (x_max, current, 2.0 * bench.size.current, force, rate, 1e4, force, rate, 0.0, 0.0, True),
    }
    arrays = {f"loop.{name}": array for name, array in loop.arrays.items()}
    return make_record(FILTER_DTYPE, values, arrays | {"table": metric.table})


def default_filter(bench: Bench | None = None) -> LoopFilter:
    """Return the shipped metric's filter on the shipped learned bench, for a box of `bench` (default: nominal)."""
    return loop_filter(ScheduledMetric.load(), learned_bench.load_model(), bench or Bench.nominal())
