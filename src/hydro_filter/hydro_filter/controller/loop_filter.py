# SPDX-License-Identifier: Apache-2.0
"""The contraction filter as an object, for the node; its decision is that of firmware/hydro/loop_filter.h.

::

    contraction_filter = default_filter(bench)
    contraction_filter.correct(sample)                    Sample in, Result out, one bench, as the node runs it
    records.decide(address, parts, memory, ...)           the same for a compiled loop

The law is known by f_c, f_c', C_1, C_2 (`hydro_filter.model.sample.Sample.followed`). v is from f_r whatever the law
follows: a loop that decays does so whatever it follows.

Samples must be consecutive: the memory simulates the spool from their currents. A correction acts one sample after its
own. Certified gains and limits: safety.md.

`LoopFilter` also monitors whether the model still fits the bench (firmware/hydro/monitor.h); if not, every result is
MISMATCH without a correction. A compiled loop does not: its benches are simulated, by that model or deliberately by
others.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np

from hydro_core.settings import check, quantity
from hydro_core.signals import SAMPLE_PERIOD, CorrectionStatus
from hydro_core.size import Size
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model.loop import coordinates_of, loop_of, overlap_of
from hydro_filter.model.records import (
    DECISION,
    FILTER,
    SAMPLE,
    library,
    memories,
    monitors,
    record_of,
)
from hydro_filter.model.sample import Sample
from hydro_sim.box.firmware import Records, at
from hydro_sim.files import learned_bench
from hydro_sim.model.bench import NOMINAL, Bench

SAME = 1e-3
"""HYDRO_SAME: difference of C_1 that is none."""

EQUATIONS = ("load", "motion", "hydraulic force", "chamber a", "chamber b")
"""Of the model monitor."""
SUSPECTS = (
    "the spring or its load cell",
    "mass, friction or spring",
    "the piston's area or the load cell of f_h",
    "valve, supply, oil or area",
    "valve, supply, oil or area",
)
"""Cause of a violation of each equation."""

FORCE, RATE, PRESSURE, POSITION, SPEED, CURRENT, GAIN = 1e5, 1e9, 1e8, 1.0, 20.0, 1e4, 1e4
"""N, N/s, Pa, m, m/s, A, 1/s: magnitudes beyond which a sample is none of the nominal bench, far beyond its sensors."""


@dataclass(frozen=True, kw_only=True)
class LoopFilterSettings:
    """Settings of the filter."""

    contraction_rate: Annotated[float, quantity("1/s", 0.0, 10.0)] = 0.1
    """lambda for gains of the certified range; the paper's 0.1."""
    foreign_rate: Annotated[float, quantity("1/s", 0.0, 15.0)] = 8.0
    """lambda for all other gains, whose loop the correction closes: how fast an error has to decay."""
    noise_share: Annotated[float, quantity("-", 0.0, 100.0)] = 1.0
    """What of the metric's own noise level counts as nothing; 0: correct noise as well."""
    innovation_limit: Annotated[float, quantity("-", 0.3, 10.0)] = 1.0
    """How far the model's predictions may be off before nothing rests on them, of what is allowed."""
    state_age_max: Annotated[float, quantity("s", 0.001, 0.1)] = 5e-3
    """A state that is older, or stamped so far ahead, is not acted upon."""
    bypass: bool = False
    """Correct nothing and say so in every correction: status BYPASSED."""

    def __post_init__(self) -> None:
        check(self)


class Result(NamedTuple):
    """Result of one sample."""

    delta_u: float
    """A, finite, 0 unless status is MODIFIED or RELAXED."""
    before: float
    """M_c [1/s] without the correction; NaN if it was not evaluated or not finite."""
    after: float
    """M_c [1/s] with it."""
    status: CorrectionStatus


STATUSES = tuple(CorrectionStatus)
NO_CERTIFICATE = {
    True: "its metric is not made for the compensated law; one of a bench file is (`learn_metric --model FILE.yaml`)",
    False: "its metric is not made for the paper's law, whose loop decays at no gain on this bench",
}
"""Why there is none, by whether the compensated law acts."""


class LoopFilter:
    """Filter of one bench. Never raises on a sample.

    Parameters
    ----------
    parts
        Of `loop_parts`.
    settings
        Only age, bypass and `innovation_limit` are used here; the others are part of `parts`.
    others
        The same for other C_1.
    """

    def __init__(
        self, parts: Records, settings: LoopFilterSettings | None = None, others: Sequence[Records] = ()
    ) -> None:
        self.parts = parts
        self.settings = settings or LoopFilterSettings()
        self.memory, self.monitor = memories(), monitors()
        self.decision = np.zeros(1, DECISION)
        """Of the last sample, with a, b, low, high of its QP."""
        self._sample = np.zeros(1, SAMPLE)
        self._bytes, self._judge = self._sample.view(np.uint8).data, library().hydro_c_filter_judge
        self._every = [(float(each["velocity_compensation"][0]), each) for each in (parts, *others)]
        self._unknown = [not any((c_1 == 1.0) is paper for c_1, _ in self._every) for paper in (True, False)]
        self._at = tuple(map(at, (self.memory, self.monitor, self._sample, self.decision)))

    @property
    def mismatch(self) -> str:
        """Why the model does not fit this bench, as text; empty while it does."""
        if not (broken := int(self.monitor["broken"][0])):
            return ""
        name, suspects, ratio = EQUATIONS[broken - 1], SUSPECTS[broken - 1], float(self.monitor["ratio"][0])
        return f"the model's {name} ({suspects}) is off by {ratio:.1f} times what is allowed"

    def unknown(self, *, compensated: bool) -> str:
        """Return why it has no certificate under the compensated law, or the paper's; empty if it has."""
        return NO_CERTIFICATE[compensated] if self._unknown[compensated] else ""

    def reset(self) -> None:
        """Reset to the initial state."""
        self.skip()
        self.monitor["broken"] = 0

    def skip(self) -> None:
        """Announce that samples are missing before the next one. Findings about the model are kept."""
        self.memory[:] = np.zeros(1, self.memory.dtype)
        for name in ("seen", "held", "sums", "runs"):
            self.monitor[name] = 0

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""
        if self._unknown[sample.compensated]:
            self.skip()
            return Result(0.0, math.nan, math.nan, CorrectionStatus.BYPASSED)
        law, parts = sample.followed, self.parts
        for c_1, each in self._every[1:]:
            if abs(law[2] - law[3] * c_1) <= SAME * law[3]:
                parts = each
        _PACK(
            self._bytes, 0, *sample.state.tolist(), sample.nominal_current, sample.valve_current,
            sample.reference_force, sample.reference_rate, sample.proportional_gain, *law, sample.armed,
        )  # fmt: skip
        self._judge(at(parts), self.settings.innovation_limit, *self._at)
        delta_u, before, after, _, _, _, _, status, _ = (
            self.decision.item()
        )  # also of an old sample: the memory moves on
        if status == CorrectionStatus.NAN:
            delta_u, before, after = 0.0, math.nan, math.nan
        if self.settings.bypass:
            return Result(0.0, before, before, CorrectionStatus.BYPASSED)
        if status == CorrectionStatus.NAN:
            return Result(0.0, math.nan, math.nan, CorrectionStatus.NAN)
        if self.monitor["broken"][0]:  # a certificate of another bench says nothing
            return Result(0.0, math.nan, math.nan, CorrectionStatus.MISMATCH)
        if not abs(age) <= self.settings.state_age_max:
            return Result(0.0, math.nan, math.nan, CorrectionStatus.STALE)
        if not sample.armed:
            return Result(0.0, 0.0, 0.0, CorrectionStatus.PASS)
        return Result(delta_u, before, after, STATUSES[status])


_PACK = struct.Struct("17d?").pack_into
"""Into a record of SAMPLE: thrice as fast as by its fields' names."""


def loop_filter(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> LoopFilter:
    """Return the filter of a metric's file, with all its certificates (raises as `loop_parts`)."""
    first, *others = (loop_parts(each, model, bench, settings) for each in metric.certificates)
    return LoopFilter(first, settings, others)


def loop_parts(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> Records:
    """Return a record of FILTER, shape (1,): of a metric, its training model, and the bench that the box believes.

    Raises ValueError: the metric's coordinates are not those of the model's loop, or as `loop_of`.
    """
    chosen, levels, loop = settings or LoopFilterSettings(), metric.thresholds, loop_of(model, bench)
    if metric.coordinates != (needed := coordinates_of(loop)):
        raise ValueError(
            f"the metric is of the coordinates {', '.join(metric.coordinates)}, this model's loop has "
            f"{', '.join(needed)}: make one with `ros2 run hydro_filter learn_metric --model`"
        )
    kept = {
        name: math.exp(-2.0 * rate * SAMPLE_PERIOD)
        for name, rate in (("kept", chosen.contraction_rate), ("foreign_kept", chosen.foreign_rate))
    }
    values = {f"loop.{name}": value for name, value in loop.values.items()} | metric.fields | overlap_of(model) | kept
    values |= {
        "noise_size": chosen.noise_share * levels.noise_size,
        "foreign_noise_size": chosen.noise_share * levels.foreign_noise_size,
        "integral_allowance": levels.integral_allowance, "most": _most(bench.size),
    }  # fmt: skip
    arrays = {f"loop.{name}": array for name, array in loop.arrays.items()}
    return record_of(FILTER, values, arrays | {"table": metric.table})


def _most(size: Size) -> tuple[Any, ...]:
    """Magnitudes of a record of SAMPLE that are none of a bench of this size."""
    forces, pressures, lengths, currents = (
        getattr(size, name) / getattr(NOMINAL, name) for name in ("force", "pressure", "length", "current")
    )
    force, rate, current = forces * FORCE, forces * RATE, currents * CURRENT
    x = (force, rate, force, rate, pressures * PRESSURE, pressures * PRESSURE, lengths * POSITION, lengths * SPEED)
    return x, current, 2.0 * size.current, force, rate, GAIN, force, rate, 0.0, 0.0, True


def default_filter(bench: Bench | None = None) -> LoopFilter:
    """Return the shipped metric on the shipped learned bench, for a box configured for `bench` (default: nominal)."""
    return loop_filter(ScheduledMetric.load(), learned_bench.load_model(), bench or Bench.nominal())
