# SPDX-License-Identifier: Apache-2.0
"""Contraction filter in a vectorised environment: from one sample to the next one's correction, as in the graph.

A kind is a NamedTuple with a compiled `correct` dispatched on its type: none, learned metric.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba.extending import overload

from hydro_bridge.signals import Flag
from hydro_filter.controller import loop_decision
from hydro_filter.controller.loop_decision import LoopParts, Workspace
from hydro_filter.controller.loop_filter import default_filter
from hydro_filter.model.loop import memories
from hydro_policy.envs import FILTERS
from hydro_sim.model.bench import Bench

_ARMED = np.uint32(Flag.ARMED)


class NoFilter(NamedTuple):
    """No filter: the box gets the gains unfiltered, flagged FILTER_STALE."""

    fresh: bool = False


class LearnedFilter(NamedTuple):
    """The filter with the learned metric, with one memory per bench."""

    fresh: bool
    parts: LoopParts
    memory: npt.NDArray[np.void]
    workspace: Workspace


FleetFilter = NoFilter | LearnedFilter


def fleet_filter(kind: str, believed: Bench, count: int) -> FleetFilter:
    """Return the filter of a kind in `FILTERS` for `count` benches, designed for the bench `believed`."""
    if kind == "none":
        return NoFilter()
    if kind == "learned":
        parts = default_filter(believed).parts
        return LearnedFilter(True, parts, memories(count), loop_decision.workspace(parts))
    raise ValueError(f"there is no filter {kind!r}; there are {', '.join(FILTERS)}")


def reset_memory(filters: FleetFilter, index: int) -> None:
    """Reset a bench's memory: its next sample does not follow the last one."""
    if isinstance(filters, LearnedFilter):
        filters.memory[index] = np.zeros(1, filters.memory.dtype)[0]


def correct(filters: Any, i: int, x: Any, sample: Any, law: Any) -> float:
    """Return delta_u [A] for the next sample of bench i under a law (f_c, f_c', C_1, C_2); for compiled code."""
    raise NotImplementedError("compiled code only")


@overload(correct)
def _correct(filters, i, x, sample, law):
    kind = getattr(filters, "instance_class", None)
    if kind is NoFilter:
        return lambda filters, i, x, sample, law: 0.0
    if kind is LearnedFilter:

        def learned(filters, i, x, sample, law):
            signals = sample.nominal_valve_current, sample.valve_current, sample.reference_force
            armed = (sample.flags & _ARMED) != 0
            return loop_decision.decide(
                filters.parts, filters.memory[i], x, signals[0], signals[1], signals[2], sample.reference_force_rate,
                sample.proportional_gain, law, armed, filters.workspace,
            )[0]  # fmt: skip

        return learned
    return None
