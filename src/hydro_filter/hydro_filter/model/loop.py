# SPDX-License-Identifier: Apache-2.0
"""Dispatch over the kinds of loops by type: the structured model's (`loop_model`) or a bench file's (`bench_loop`).

For compiled code and for Python; the structured model's functions are in `displacement` and `loop_model`,
a bench file's in `bench_states`, `bench_displacement` and `bench_linearization`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import overload

from hydro_filter.model import bench_displacement, bench_linearization, bench_states, displacement, loop_model
from hydro_filter.model.bench_loop import bench_loop, bench_step
from hydro_filter.model.bench_parts import BENCH_MEMORY_DTYPE, BenchLoop, BenchParts, BenchStep
from hydro_filter.model.displacement import MEMORY_DTYPE
from hydro_filter.model.loop_model import LoopModel, LoopStep
from hydro_sim.box.box import BoxConfig
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel

Loop = LoopModel | BenchLoop
Step = LoopStep | BenchStep


def loop_of(model: StructuredModel | Bench, believed: Bench, box: BoxConfig | None = None) -> Loop:
    """Return the loop of a model under a box configured for `believed` (raises as `bench_loop`)."""
    return bench_loop(model, believed, box) if isinstance(model, Bench) else loop_model.loop_model(model, believed, box)


def closing_current(loop: Loop) -> float:
    """Return the current [A] that closes the valve: from a bench file's null shifts, else zero."""
    return -(loop.model.before + loop.model.after) if isinstance(loop, BenchLoop) else 0.0


def step_of(loop: Loop) -> Step:
    """Allocate the workspace of one caller."""
    return bench_step(loop) if isinstance(loop, BenchLoop) else loop_model.loop_step()


def memories(loop: Loop, count: int = 1) -> npt.NDArray[np.void]:
    """Return new memories of `count` benches, shape (count,)."""
    return np.zeros(count, BENCH_MEMORY_DTYPE if isinstance(loop, BenchLoop) else MEMORY_DTYPE)


def coordinates_of(loop: Loop) -> tuple[str, ...]:
    """Return the names of the certificate's coordinates: `LOOP_FIELDS`, and those that a bench file adds."""
    if not isinstance(loop, BenchLoop):
        return loop_model.LOOP_FIELDS
    shown = [f"p_{'ab'[chamber]}_shown{ending}" for chamber in loop.model.lagging[:, 2] for ending in ("", "_rate")]
    return (*loop_model.LOOP_FIELDS, *shown, *(f"current_{i + 1}" for i in range(loop.model.on_their_way)))


def driven_coordinate(loop: Loop) -> int:
    """Return the coordinate whose entry of G follows g everywhere: the spool's rate, or the newest current."""
    if isinstance(loop, BenchLoop) and loop.model.on_their_way:
        return len(loop.scale) - loop.model.on_their_way
    return loop_model.Q_SPOOL_RATE


def is_bench_file_loop(kind: Any) -> bool:
    """Whether a type of compiled code is a bench file's loop, or its model."""
    return isinstance(kind, types.BaseNamedTuple) and kind.instance_class in (BenchLoop, BenchParts)


def _settle(loop, memory, x, current, reference_rate):
    raise NotImplementedError("compiled code only")


def _follow(loop, memory, x, current, reference_rate):
    raise NotImplementedError("compiled code only")


def _displace(loop, memory, x, reference, reference_rate, v):
    raise NotImplementedError("compiled code only")


def _linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    raise NotImplementedError("compiled code only")


def _bench_settle(loop, memory, x, current, reference_rate):
    bench_states.settle(loop, memory, x, current, reference_rate)


@overload(_settle, inline="always")
def _settle_of(loop, memory, x, current, reference_rate):
    return _bench_settle if is_bench_file_loop(loop) else displacement.settle.py_func


def _bench_follow(loop, memory, x, current, reference_rate):
    bench_states.follow(loop, memory, x, current, reference_rate)


@overload(_follow, inline="always")
def _follow_of(loop, memory, x, current, reference_rate):
    return _bench_follow if is_bench_file_loop(loop) else displacement.follow.py_func


def _bench_displace(loop, memory, x, reference, reference_rate, v):
    bench_displacement.displace(loop, memory, x, reference, reference_rate, v)


@overload(_displace, inline="always")
def _displace_of(loop, memory, x, reference, reference_rate, v):
    return _bench_displace if is_bench_file_loop(loop) else displacement.displace.py_func


def _bench_linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    bench_linearization.linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step)


@overload(_linearize, inline="always")
def _linearize_of(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    return _bench_linearize if is_bench_file_loop(loop) else loop_model.linearize.py_func


@njit(inline="always")
def settle(loop, memory, x, current, reference_rate):
    """Initialise from the first sample."""
    _settle(loop, memory, x, current, reference_rate)


@njit(inline="always")
def follow(loop, memory, x, current, reference_rate):
    """Advance the memory by one sample, during which the valve holds `current` [A]."""
    _follow(loop, memory, x, current, reference_rate)


@njit(inline="always")
def displace(loop, memory, x, reference, reference_rate, v):
    """Write v, of each coordinate, of a sample x, shape (8,), at f_r [N] and f_r' [N/s]."""
    _displace(loop, memory, x, reference, reference_rate, v)


@njit(inline="always")
def linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    """Fill `step` at x (8,) and a memory's `hidden`, for the nominal and the valve's current [A], K_p, (C_1, C_2)."""
    _linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step)
