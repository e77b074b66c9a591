# SPDX-License-Identifier: Apache-2.0
"""The filter in C (`firmware/hydro/loop_filter.h`) as a library: its structures as numpy records, and its calls.

::

    record = filter_record(metric, model, bench)               a record of FILTER_DTYPE, shape (1,)
    linearize(loop, samples)                                   F, G, K, v of successive samples
    decide(decide_address(), record, memory, sample, decision) one decision, in a loop that numba compiles

A record and the arrays that it points to share one block of memory (`make_record`): pointers are valid as long as the
record, and a copy of the record alone must not outlive it. The library is that of the box (`hydro_sim.box.firmware`).
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic

from hydro_core.signals import FloatArray
from hydro_sim.box.firmware import DOUBLE_STRUCTURES, RecordArray, address_of, declare, library_path
from hydro_sim.model.machine_code import declare_call
from hydro_sim.model.plant import STATES_MAX

NO_STATE = -1
"""Index of a state that a bench does not have."""

READING_COUNT, EQUATION_COUNT = 5, 5


def _structure(*groups: tuple[Any, str]) -> np.dtype[np.void]:
    """Return the aligned dtype of fields, given as kinds with the names of their fields."""
    return np.dtype([(name, kind) for kind, names in groups for name in names.split()], align=True)


_REAL, _INT, _FLAG, _POINTER = np.float64, np.int32, np.bool_, np.uintp
_READING_FIELD, _HIDDEN_FIELD = (_REAL, (READING_COUNT,)), (_REAL, (STATES_MAX,))

MODEL_DTYPE = _structure((_POINTER, "rates k"), (_INT, "states spool spool_rate cell cell_rate"))
LAGGING_DTYPE = _structure((_INT, "signal rate chamber"), (_REAL, "age"))
LOOP_DTYPE = _structure(
    (MODEL_DTYPE, "whole linear"), (_POINTER, "sample sample_k jacobian from_whole rest forces scale kept"),
    ((LAGGING_DTYPE, (2,)), "lagging"), ((_REAL, (3, 6)), "observer"),
    (_INT, "coordinates points lagging_count past at_valve on_their_way force_shown"), (_FLAG, "holds"),
    (_REAL, "level first step before after delay spool_age lag inertia"), (_READING_FIELD, "gain bias allowed"),
    (_REAL, "area ratio mass dead_a dead_b stroke least_gain least_opening bend_max creep gain_floor velocity_memory"),
    (DOUBLE_STRUCTURES.config["bench"], "bench"),
)  # fmt: skip
"""Structure hydro_loop of firmware/hydro/loop.h, as those of model, lagging reading, sample and filter state are."""
SAMPLE_DTYPE = _structure(
    ((_REAL, (8,)), "x"),
    (_REAL, "nominal current reference reference_rate k_p followed followed_rate c_1 c_2"), (_FLAG, "armed"),
)  # fmt: skip
FILTER_STATE_DTYPE = _structure(
    (_HIDDEN_FIELD, "hidden"), (_REAL, "opening opening_rate reference_rate"), (_FLAG, "running")
)
FILTER_DTYPE = _structure(
    (LOOP_DTYPE, "loop"), (_POINTER, "table"), (_INT, "rows"),
    (_REAL, "gain_low gain_high gain_step floor kept foreign_kept noise_size foreign_noise_size integral_allowance"),
    (_REAL, "velocity_compensation closing back out"), (SAMPLE_DTYPE, "most"),
)  # fmt: skip
"""Structure hydro_loop_filter of firmware/hydro/loop_filter.h, as DECISION_DTYPE is."""
DECISION_DTYPE = _structure((_REAL, "delta_u before after a b low high"), (np.uint32, "status"), (_FLAG, "restorable"))
MONITOR_DTYPE = _structure(
    (_READING_FIELD, "last middle"), (_HIDDEN_FIELD, "hidden"), (_REAL, "opening cell"),
    ((_REAL, (EQUATION_COUNT, 2)), "sums"), ((_INT, (EQUATION_COUNT, 2)), "runs"),
    (_INT, "seen broken held"), (_REAL, "ratio effort"),
)  # fmt: skip
"""Structure hydro_monitor of firmware/hydro/monitor.h."""


def make_record(
    kind: np.dtype[np.void], values: Mapping[str, Any], arrays: Mapping[str, npt.NDArray[Any]]
) -> RecordArray:
    """Return a record of a C structure, shape (1,), whose pointers refer to `arrays`.

    `values`, `arrays`: by field name; nested fields with a dot.
    """
    sizes = [kind.itemsize, *(array.nbytes for array in arrays.values())]
    begins = np.cumsum([-(-size // 8) for size in sizes])  # in words
    memory = np.zeros(int(begins[-1]))
    record: RecordArray = memory.view(np.uint8)[: kind.itemsize].view(kind)
    pointers = {}
    for (name, array), begin in zip(arrays.items(), begins, strict=False):
        memory.view(np.uint8)[8 * begin : 8 * begin + array.nbytes] = np.ascontiguousarray(array).view(np.uint8).ravel()
        pointers[name] = address_of(memory) + 8 * int(begin)
    for name, value in {**values, **pointers}.items():
        *path, last = name.split(".")
        field: Any = record
        for part in path:
            field = field[part]
        field[last] = value
    return record


def new_memories(count: int = 1) -> RecordArray:
    """Return initial filter states of `count` benches: records of FILTER_STATE_DTYPE, shape (count,)."""
    return np.zeros(count, FILTER_STATE_DTYPE)


def new_monitors(count: int = 1) -> RecordArray:
    """Return initial monitor states of `count` benches: records of MONITOR_DTYPE, shape (count,)."""
    return np.zeros(count, MONITOR_DTYPE)


@cache
def library() -> ctypes.PyDLL:
    """Load the filter's C library. Calls keep the GIL, as they take some microseconds.

    Raises SettingsError: the library is not built, or of another version.
    """
    code = ctypes.PyDLL(str(library_path("double")))
    pointer, number, count = ctypes.c_void_p, ctypes.c_double, ctypes.c_size_t
    declared: dict[str, tuple[Any, list[Any]]] = {
        "hydro_c_filter_sizes": (None, [pointer]),
        "hydro_c_filter_decide": (None, [pointer] * 4),
        "hydro_c_filter_judge": (None, [pointer, number, *[pointer] * 4]),
        "hydro_c_filter_metric": (ctypes.c_int, [pointer, number, number, pointer]),
        "hydro_c_filter_follow": (None, [pointer, pointer, count, *[pointer] * 9]),
        "hydro_c_filter_watch": (None, [pointer, number, pointer, pointer, count, pointer, pointer]),
        "hydro_c_filter_sensitivity": (None, [pointer, pointer, number, pointer]),
        "hydro_c_filter_gradient": (None, [pointer, pointer, pointer]),
        "hydro_c_closed_form": (number, [number] * 4 + [pointer]),
    }
    kinds = (FILTER_DTYPE, FILTER_STATE_DTYPE, MONITOR_DTYPE, SAMPLE_DTYPE, DECISION_DTYPE)
    declare(code, declared, "hydro_c_filter_sizes", kinds)
    return code


@cache
def decide_address() -> int:
    """Return the address of the C function behind `decide`. Raises SettingsError, as `library`."""
    return ctypes.cast(library().hydro_c_filter_decide, ctypes.c_void_p).value or 0


@intrinsic
def decide(typingctx: Any, address: Any, record: Any, memory: Any, sample: Any, decision: Any) -> Any:
    """Numba intrinsic: decide the correction of a sample without the monitor; arguments are records of shape (1,)."""
    return declare_call(types.void(types.int64, record, memory, sample, decision), "pppp")


class Linearization(NamedTuple):
    """Linearization of n samples of a loop with c coordinates and m states."""

    transition: FloatArray
    """F, shape (n, c, c). F, G and K have only the samples selected for linearization."""
    input_vector: FloatArray
    """G [1/A], shape (n, c)."""
    feedback: FloatArray
    """K [A], shape (n, c)."""
    displacement: FloatArray
    """v, shape (n, c)."""
    states: FloatArray
    """States of the whole model, measured and simulated, shape (n, m)."""
    opening: FloatArray
    """Opening of the valve [A] and its rate [A/s], shape (n, 2)."""
    integral: FloatArray
    """I [N/s] of the force law, shape (n,)."""


def linearize(
    loop: RecordArray,
    samples: RecordArray,
    memory: RecordArray | None = None,
    linearized: npt.NDArray[np.bool_] | None = None,
) -> Linearization:
    """Linearize the loop at successive samples by the filter's C functions.

    Parameters
    ----------
    loop
        A record of LOOP_DTYPE, shape (1,).
    samples
        Records of SAMPLE_DTYPE, shape (n,).
    memory
        Filter state, a record of FILTER_STATE_DTYPE, shape (1,), updated in place; None: a new one.
    linearized
        Mask of the samples to linearize, shape (n,); None: all.
    """
    n, width, states = len(samples), int(loop["coordinates"][0]), int(loop["whole"]["states"][0])
    rows = n if linearized is None else int(linearized.sum())
    shapes = (rows, width, width), (rows, width), (rows, width), (n, width), (n, states), (n, 2), (n,)
    output = Linearization(*(np.empty(shape) for shape in shapes))
    memory = new_memories() if memory is None else memory
    chosen = None if linearized is None else address_of(linearized)
    library().hydro_c_filter_follow(
        address_of(loop), address_of(memory), n, address_of(samples), chosen, *map(address_of, output)
    )
    return output


def run_monitor(
    loop: RecordArray, samples: RecordArray, memory: RecordArray, monitor: RecordArray, limit: float = 1.0
) -> FloatArray:
    """Run the model monitor on successive samples; return its CUSUM statistics after each, shape (n, 5, 2)."""
    sums = np.empty((len(samples), EQUATION_COUNT, 2))
    at = map(address_of, (memory, monitor))
    library().hydro_c_filter_watch(address_of(loop), limit, *at, len(samples), *map(address_of, (samples, sums)))
    return sums


def law_gradient(loop: RecordArray, sample: RecordArray) -> FloatArray:
    """Return the gradient du/dx of the force law at a sample, shape (8,), A per unit of each measurement."""
    output = np.empty(8)
    library().hydro_c_filter_gradient(address_of(loop), address_of(sample), address_of(output))
    return output
