# SPDX-License-Identifier: Apache-2.0
"""The C firmware (`firmware/`) as a library: its structures as numpy records, and its calls, also from compiled code.

::

    code = function_addresses()                     in this process, for compiled loops
    receive(code.receive, box, config, command, t)  receive a command at box time t [s]
    tick(code.tick, box, config, x, t, sample)      run one sample on the measurement x, shape (8,)

The four records have shape (1,) and the types `box`, `config` and `command` of `DOUBLE_STRUCTURES`, and
`signals.STATE_DTYPE`. The caller owns all memory and gives the configuration with each call: a record may be copied and
pickled. `make setup` builds the library in double and in single precision as the package hydro_firmware.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.extending import intrinsic

from hydro_bridge.serial.protocol import GAIN_FIELDS
from hydro_core.settings import SettingsError
from hydro_core.signals import FloatArray, ReferenceSignal
from hydro_sim.model.machine_code import declare_call

Precision = Literal["double", "single"]
RecordArray = npt.NDArray[np.void]
Pointer = ctypes.c_void_p

BURST_MAX = 564
"""HYDRO_BURST_MAX: largest number of bytes that a box sends after one sample."""
SHAPING_COEFFICIENT_COUNT = 5
"""Coefficients a_0 to a_4 at the beginning of a law's shaping."""
VELOCITY_COMPENSATION_INDEX, VALVE_GAIN_SCALE_INDEX = 5, 6
"""Indices of C_1 and C_2 in a law's shaping."""

BENCH_FIELDS = (
    "bulk_modulus", "piston_area", "area_ratio", "stroke", "supply_pressure", "tank_pressure", "dead_volume_a",
    "dead_volume_b", "valve_gain", "valve_current_max", "closing", "overlap_back", "overlap_out",
)  # fmt: skip


class Structures(NamedTuple):
    """Structures of `hydro/box.h` in one precision, under the names of their fields."""

    law: np.dtype[np.void]
    config: np.dtype[np.void]
    signal: np.dtype[np.void]
    command: np.dtype[np.void]
    box: np.dtype[np.void]


def structures(real: Any) -> Structures:
    """Return the structures with `real` as hydro_real."""
    kinds: dict[str, Any] = {
        "real": real, "time": np.float64, "uint32": np.uint32, "bool": np.bool_, "address": np.uintp,
        "shaping": (real, (7,)), "measured": (real, (8,)), "values": (real, (14,)), "refused": (np.uint32, (2,)),
        "piece": (np.uint8, (160,)), "name": (np.uint8, (32,)), "digest": (np.uint8, (12,)),
    }  # fmt: skip

    def structure(name: str, text: str) -> None:
        members = ((member, kinds[kind]) for kind, *names in map(str.split, text.split(";")) for member in names)
        kinds[name] = np.dtype(list(members), align=True)

    structure("bench", f"real {' '.join(BENCH_FIELDS)}")
    structure("law", f"real {' '.join(GAIN_FIELDS)} reference_max; shaping safe low high rate")
    kinds["laws"] = (kinds["law"], (2,))
    structure(
        "config",
        "bench bench; laws laws; real delta_u_max load_force_limit gain_floor force_range recovery_margin; "
        "measured low high; real force_rate_age velocity_age; time hold_timeout trip_timeout; "
        "uint32 feedback integral_form; name name; digest digest",
    )
    structure("stream", "piece piece; uint32 count frames bad unknown foreign")
    structure(
        "guard",
        "uint32 law; real delta_kp delta_ki delta_u; shaping shaping; refused refused; bool heard; uint32 newest",
    )
    structure(
        "arming",
        "bool arm_wanted disarm_seen armed tripped filter_fresh; uint32 faults; time received_at armed_at; real excess",
    )
    structure("signal", "uint32 waveform; real amplitude offset; time frequency phase start")
    structure("reference", "signal leaving coming wanted; time fade_start")
    structure("sample", "time time; uint32 sequence; values values; uint32 flags")
    structure("acting", "uint32 law; real reference reference_rate; shaping shaping")
    structure(
        "command",
        "uint32 sequence corrects; bool arm filter_fresh; uint32 broken; real delta_kp delta_ki delta_u; "
        "signal reference; uint32 law; shaping shaping",
    )
    structure(
        "box",
        "address config; stream stream; guard guard; arming arming; reference reference; sample sample; acting acting; "
        "real integral; command now next; bool has_now has_next greeted greeting; "
        "uint32 sequence epoch hellos last_command confirmed taken stale greetings",
    )
    return Structures(*(kinds[name] for name in Structures._fields))


DOUBLE_STRUCTURES, SINGLE_STRUCTURES = structures(np.float64), structures(np.float32)
STRUCTURES: dict[Precision, Structures] = {"double": DOUBLE_STRUCTURES, "single": SINGLE_STRUCTURES}


def library_path(precision: Precision) -> Path:
    """Return the path of the library that set-up built. Raises SettingsError: it is not built."""
    name = f"libhydro_box_{precision}.so"
    for prefix in filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)):
        if (path := Path(prefix, "lib", name)).is_file():
            return path
    raise SettingsError(f"{name} is not built: run `make setup`, and `source install/setup.bash`")


def declare(
    code: ctypes.CDLL, functions: Mapping[str, tuple[Any, list[Any]]], sizes: str, kinds: Sequence[np.dtype[Any]]
) -> None:
    """Declare the functions of a library. Raises SettingsError: it is of another version.

    `functions`: result and arguments by name. `sizes`: name of the function that tells the sizes of `kinds`.
    """
    found = (ctypes.c_size_t * len(kinds))()
    with contextlib.suppress(AttributeError):  # the sizes stay 0
        for name, (result, arguments) in functions.items():
            function = getattr(code, name)
            function.restype, function.argtypes = result, arguments
        getattr(code, sizes)(found)
    if list(found) != [kind.itemsize for kind in kinds]:
        raise SettingsError("the built firmware is of another version: run `make setup`")


@cache
def library(precision: Precision = "double") -> ctypes.CDLL:
    """Load the firmware's library. Raises SettingsError: it is not built, or of another version."""
    code = ctypes.CDLL(str(library_path(precision)))
    number, count = ctypes.c_double, ctypes.c_size_t
    declared: dict[str, tuple[Any, list[Any]]] = {
        "hydro_c_sizes": (None, [Pointer]),
        "hydro_c_power_on": (None, [Pointer, Pointer, ctypes.c_uint32]),
        "hydro_c_receive": (None, [Pointer, Pointer, Pointer, number]),
        "hydro_c_tick": (None, [Pointer, Pointer, Pointer, number, Pointer]),
        "hydro_c_bytes": (None, [Pointer, ctypes.c_char_p, count]),
        "hydro_c_frames": (count, [Pointer, Pointer, Pointer]),
        "hydro_c_nominal_current": (number, [Pointer, Pointer, *[number] * 6]),
        "hydro_c_play": (None, [Pointer, Pointer, count, Pointer, Pointer]),
    }
    kinds = STRUCTURES[precision]
    declare(code, declared, "hydro_c_sizes", (kinds.box, kinds.config, kinds.command, kinds.signal))
    return code


def address_of(array: npt.NDArray[Any]) -> int:
    """Return the address of an array's memory."""
    return array.ctypes.data


class FunctionAddresses(NamedTuple):
    """Addresses of the library's functions in this process, for `receive` and `tick`."""

    receive: int
    tick: int


@cache
def function_addresses(precision: Precision = "double") -> FunctionAddresses:
    """Return the addresses of the library's functions. Raises SettingsError, as `library`."""
    functions = library(precision).hydro_c_receive, library(precision).hydro_c_tick
    return FunctionAddresses(*(ctypes.cast(function, Pointer).value or 0 for function in functions))


@intrinsic
def receive(typingctx: Any, address: Any, box: Any, config: Any, command: Any, time: Any) -> Any:
    """Numba intrinsic: receive a command at box time [s]."""
    return declare_call(types.void(types.int64, box, config, command, types.float64), "pppd")


@intrinsic
def tick(typingctx: Any, address: Any, box: Any, config: Any, measurement: Any, time: Any, sample: Any) -> Any:
    """Numba intrinsic: run one sample on a measurement, shape (8,), at box time [s] into a record of `STATE_DTYPE`."""
    return declare_call(types.void(types.int64, box, config, measurement, types.float64, sample), "pppdp")


def signal_record(signal: ReferenceSignal) -> tuple[float, ...]:
    """Return a reference as the fields of a record of hydro_signal."""
    return signal.waveform, signal.amplitude, signal.offset, signal.frequency, signal.phase, 0.0


def reference_force(signal: ReferenceSignal, times: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return value [N] and rate [N/s] of a signal that starts at time 0, at `times` [s], shape (n,) each."""
    record, times = np.array([signal_record(signal)], DOUBLE_STRUCTURES.signal), np.ascontiguousarray(times, np.float64)
    values, rates = np.empty((2, len(times)))
    library().hydro_c_play(address_of(record), address_of(times), len(times), address_of(values), address_of(rates))
    return values, rates
