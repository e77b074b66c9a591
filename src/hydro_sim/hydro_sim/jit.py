# SPDX-License-Identifier: Apache-2.0
"""numba's `njit` with the options of all kernels of hydro: cached, and with IEEE 754 division.

numba's own default follows Python: a division by zero raises. At the valve nothing may raise on a sample, and a sample
can make a divisor zero: at some position a chamber's volume vanishes. Here this gives an infinity or NaN, which every
caller has to reject anyway. Used bare (`@njit`) or with more options (`@njit(inline="always")`).

A kernel with fastmath must not call one without: numba compiles that one with the caller's fastmath if it comes first,
and caches it so, for every other caller.
"""

from __future__ import annotations

import fcntl
import functools
import os
import sys
import tempfile
from importlib.machinery import SourceFileLoader
from modulefinder import ModuleFinder
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import FunctionCache

LOG_VARIABLE = "HYDRO_COMPILATIONS"
"""Environment variable that names a file: each compilation appends a line. After set-up there is none."""
_USER_CACHE = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))


def _is_writable(folder: Path) -> bool:
    return os.access(next(place for place in (folder, *folder.parents) if place.exists()), os.W_OK)


if not (numba.config.CACHE_DIR or _is_writable(Path(__file__).parent) or _is_writable(_USER_CACHE)):
    _folder = tempfile.TemporaryDirectory(prefix="hydro-kernels-")  # of this program and those that it starts
    os.environ["NUMBA_CACHE_DIR"] = numba.config.CACHE_DIR = _folder.name
    text = f"compiled code can be kept neither in this checkout nor in {_USER_CACHE}: each start compiles for minutes, "
    print(text + "unless NUMBA_CACHE_DIR names a folder that can be written", file=sys.stderr)


@functools.cache
def _module(name: str) -> tuple[str, list[str]]:
    """File of a module of hydro, and what it imports; nothing of what is no such module."""
    top = sys.modules.get(name.partition(".")[0])
    if not name.startswith(("hydro_", "benchmarks.")) or top is None:
        return "", []
    place = Path(str(top.__file__)).parents[1].joinpath(*name.split("."))
    file = next((str(path) for path in (place.with_suffix(".py"), place / "__init__.py") if path.is_file()), "")
    code: Any = SourceFileLoader(name, file).get_code(name) if file else compile("", "", "exec")
    steps = ModuleFinder().scan_opcodes(code)
    imports = [imported for kind, imported in steps if kind == "absolute_import"]
    return file, [part for names, module in imports for part in (module, *(f"{module}.{n}" for n in names or ()))]


@functools.cache
def _source_stamp(module: str) -> list[tuple[str, int, int]]:
    """Time [ns] and size of a module's source and of all that it imports, directly or through others."""
    names, found = [module], {}
    for name in names:  # which grows
        file, imported = _module(name)
        if file and name not in found:
            found[name] = os.stat(file)
            names += imported
    return [(name, stat.st_mtime_ns, stat.st_size) for name, stat in sorted(found.items())]


class _Cache(FunctionCache):
    """numba's cache of a kernel: void after a change of any source that it depends on, not only of its own."""

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        if stamp := _source_stamp(function.__module__):  # none of a program that is not imported
            self._cache_file._source_stamp = stamp

    def save_overload(self, sig: Any, data: Any) -> None:
        """Save one at a time: of two at once the index would give one the other's file."""
        if log := os.environ.get(LOG_VARIABLE):
            with open(log, "a") as file:  # one short write: lines of several processes do not mix
                file.write(f"{Path(sys.argv[0]).name} {self._py_func.__module__}.{self._py_func.__qualname__}\n")
        with open(self._py_func.__code__.co_filename) as source:
            fcntl.flock(source, fcntl.LOCK_EX)
            super().save_overload(sig, data)


def njit(function: Any = None, *, cache: bool = True, **options: Any) -> Any:
    """Return a function as a kernel, compiled at its first call; `options`: of `numba.njit`."""
    if function is None:
        return functools.partial(njit, cache=cache, **options)
    kernel = numba.njit(error_model="numpy", **options)(function)
    if cache:
        kernel._cache = _Cache(function)
    return kernel


@njit
def copy_vector(into, values):
    """Copy a vector, into[i] = values[i], unchecked: `into` must be as long as `values`.

    `into[:] = values` would compile the creation of an error message too, in each function that contains it and again
    in each that calls one: two thirds of the compilation time of the networks' gradients.
    """
    for i in range(len(values)):
        into[i] = values[i]
