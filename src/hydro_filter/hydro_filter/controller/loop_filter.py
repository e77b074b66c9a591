# SPDX-License-Identifier: Apache-2.0
"""The contraction filter as an object, for the node.

::

    contraction_filter = default_filter(bench)
    contraction_filter.correct(sample)                    Sample in, Result out, one bench, as the node runs it
    loop_decision.decide(parts, memory[i], x, ...)        the same for a compiled loop

Samples must be consecutive. A correction acts one sample after its own. Certified gains and limits: safety.md.

`LoopFilter` also monitors whether the model still fits the bench (`innovations`); if not, every result is MISMATCH
without a correction. A compiled loop does not: its benches are simulated, by that model or deliberately by others.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numba
import numpy as np

from hydro_core.settings import check, quantity
from hydro_core.signals import CorrectionStatus
from hydro_filter.certificate import NAN
from hydro_filter.controller import innovations, loop_decision
from hydro_filter.controller.loop_decision import LoopParts
from hydro_filter.metric import ScheduledMetric
from hydro_filter.model import observer
from hydro_filter.model.loop import coordinates_of, loop_of, memories, overlap_of
from hydro_filter.model.sample import Sample
from hydro_sim.files import learned_bench
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench


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


NOT_FINITE, FITS, BROKEN = range(3)
"""Results of `judge` for a sample: a number is not finite; the model holds; it does not."""


@njit
def packed(parts, workspace, monitor, limit):
    """Pack all arguments into memory for compiled code: passing seventy arrays takes as long as the decision."""
    box = numba.typed.List()
    box.append((parts, workspace, monitor, limit))
    return box


@njit
def judge(box, memory, x, nominal, current, reference, reference_rate, gain, law):
    """Return the validity of a sample, its `Decision` if armed, and a, b, low, high of its QP.

    Advances the memory, shape (1,), and the monitor.
    """
    parts, workspace, monitor, limit = box[0]
    if not loop_decision.finite(x, nominal, current, reference, reference_rate, gain, law):
        observer.reset(memory[0])
        innovations.reset(monitor[0])
        return NOT_FINITE, 0.0, math.nan, math.nan, NAN, math.nan, math.nan, 0.0, 0.0
    innovations.update(parts.loop.model, limit, monitor[0], x, memory[0].hidden)
    p = loop_decision.build_problem(
        parts, memory[0], x, nominal, current, reference, reference_rate, gain, law, workspace
    )
    delta_u, before, after, status = loop_decision.solution(parts, p, nominal)
    return BROKEN if monitor[0].broken != 0 else FITS, delta_u, before, after, status, p.a, p.b, p.low, p.high


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

    _judge = staticmethod(judge)

    def __init__(
        self, parts: LoopParts, settings: LoopFilterSettings | None = None, others: Sequence[LoopParts] = ()
    ) -> None:
        self.parts = parts
        self.settings = settings or LoopFilterSettings()
        self.problem = (math.nan, math.nan, 0.0, 0.0)
        """a, b, low, high of the last sample's QP."""
        self.memory = memories()
        self.monitor = innovations.monitors()
        workspace, limit = loop_decision.workspace(parts), self.settings.innovation_limit
        every = (parts, *others)
        self._boxes = [(each.velocity_compensation, packed(each, workspace, self.monitor, limit)) for each in every]
        self._unknown = [not any((c_1 == 1.0) is paper for c_1, _ in self._boxes) for paper in (True, False)]

    @property
    def mismatch(self) -> str:
        """Why the model does not fit this bench, as text; empty while it does."""
        return innovations.sentence(self.monitor[0])

    def unknown(self, *, compensated: bool) -> str:
        """Return why it has no certificate under the compensated law, or the paper's; empty if it has."""
        return NO_CERTIFICATE[compensated] if self._unknown[compensated] else ""

    def reset(self) -> None:
        """Reset to the initial state."""
        self.skip()
        self.monitor["broken"] = 0

    def skip(self) -> None:
        """Announce that samples are missing before the next one. Findings about the model are kept."""
        observer.reset(self.memory[0])
        innovations.reset(self.monitor[0])

    def correct(self, sample: Sample, age: float = 0.0) -> Result:
        """Decide the correction of a sample that is `age` [s] old."""
        if self._unknown[sample.compensated]:
            self.skip()
            return Result(0.0, math.nan, math.nan, CorrectionStatus.BYPASSED)
        x, nominal, law = np.ascontiguousarray(sample.state), sample.nominal_current, sample.followed
        signals = nominal, sample.valve_current, sample.reference_force, sample.reference_rate
        box = self._boxes[0][1]
        for c_1, each in self._boxes[1:]:
            if abs(law[2] - law[3] * c_1) <= loop_decision.SAME * law[3]:
                box = each
        state, delta_u, before, after, number, *problem = self._judge(
            box, self.memory, x, *signals, sample.proportional_gain, law
        )
        self.problem = tuple(problem)  # also of an old sample: the memory moves on
        if self.settings.bypass:
            return Result(0.0, before, before, CorrectionStatus.BYPASSED)
        if state == NOT_FINITE:
            return Result(0.0, math.nan, math.nan, CorrectionStatus.NAN)
        if state == BROKEN:  # a certificate of another bench says nothing
            return Result(0.0, math.nan, math.nan, CorrectionStatus.MISMATCH)
        if not abs(age) <= self.settings.state_age_max:
            return Result(0.0, math.nan, math.nan, CorrectionStatus.STALE)
        if not sample.armed:
            return Result(0.0, 0.0, 0.0, CorrectionStatus.PASS)
        return Result(delta_u, before, after, STATUSES[number])


def loop_filter(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> LoopFilter:
    """Return the filter of a metric's file, with all its certificates (raises as `loop_parts`)."""
    first, *others = (loop_parts(each, model, bench, settings) for each in metric.certificates)
    return LoopFilter(first, settings, others)


def loop_parts(
    metric: ScheduledMetric, model: Bench, bench: Bench, settings: LoopFilterSettings | None = None
) -> LoopParts:
    """Return the inputs of `decide` for a metric, its training model, and the bench that the box is configured for.

    Raises ValueError: the metric's coordinates are not those of the model's loop, or as `loop_of`.
    """
    chosen, levels, loop = settings or LoopFilterSettings(), metric.thresholds, loop_of(model, bench)
    if metric.coordinates != (needed := coordinates_of(loop)):
        raise ValueError(
            f"the metric is of the coordinates {', '.join(metric.coordinates)}, this model's loop has "
            f"{', '.join(needed)}: make one with `ros2 run hydro_filter learn_metric --model`"
        )
    return LoopParts(
        loop=loop,
        metric=metric.parts,
        rate=chosen.contraction_rate,
        foreign_rate=chosen.foreign_rate,
        noise_size=chosen.noise_share * levels.noise_size,
        foreign_noise_size=chosen.noise_share * levels.foreign_noise_size,
        integral_allowance=levels.integral_allowance,
        overlap=overlap_of(model),
        velocity_compensation=metric.velocity_compensation,
    )


def default_filter(bench: Bench | None = None) -> LoopFilter:
    """Return the shipped metric on the shipped learned bench, for a box configured for `bench` (default: nominal)."""
    return loop_filter(ScheduledMetric.load(), learned_bench.load_model(), bench or Bench.nominal())
