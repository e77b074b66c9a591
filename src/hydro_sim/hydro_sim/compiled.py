# SPDX-License-Identifier: Apache-2.0
"""Removal of stale numba caches, and a log of compilations at run time, of which there should be none after set-up.

numba recompiles a cached function when the function's own file changes, not when a function it calls does: after an
edit of `hydraulics.py` the cached `plant.advance` would go on with the old equations. `remove_stale_caches`
empties the cache of every module that imports a changed source, directly or through others.

A function with fastmath must not call a cached one without: numba compiles that one with the caller's fastmath if it
comes first, and caches it so, for every other caller.

Where the environment variable HYDRO_COMPILATIONS names a file, each compilation appends one line of JSON to it:

    {"program": "trainer", "process": 4711, "function": "hydro_policy.sac.sac.learn", "seconds": 7.3}

A function that comes from numba's cache appends none. One that is compiled inside of another has a line of its own,
and the outer one's time includes it.
"""

from __future__ import annotations

import ast
import contextlib
import fcntl
import json
import os
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any

STAMP_FILE = "sources.stamp"

SourceStats = dict[str, list[int]]
"""By source file: time of its last change [ns] and size [bytes]."""


def _sources(package: Path) -> Iterator[Path]:
    """Sources of a package; others may make and remove folders in its caches meanwhile."""
    for folder, folders, files in os.walk(package):
        folders[:] = [name for name in folders if name != "__pycache__"]
        yield from (Path(folder, name) for name in files if name.endswith(".py"))


def remove_stale_caches(*packages: Path) -> None:
    """Delete numba's cache of each module of the first package whose source, or one that it imports, has changed.

    Call it in a package's `__init__`, before its compiled modules load. Where the folder cannot be written numba keeps
    its caches elsewhere, and nothing is done: sources that cannot be written do not change. `packages`: folder of the
    package, and those of the packages that it imports.
    """
    packages = tuple(package.resolve() for package in packages)  # a built package is a link to its sources
    stamp = packages[0] / "__pycache__" / STAMP_FILE
    present = file_stats(path for package in packages for path in _sources(package))
    with contextlib.suppress(OSError):
        stamp.parent.mkdir(exist_ok=True)
        with stamp.open("a+") as file:
            # A graph starts its nodes at once: the second must not delete what the first has just compiled.
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            before: dict[str, dict[str, Any]] = {"all": {}, "modules": {}}
            with contextlib.suppress(TypeError, ValueError):  # of another form, or empty: as if nothing was compiled
                before |= json.loads(file.read())
            if before["all"] == present:
                return
            for kept in (_imports, _source):  # from before the change
                kept.cache_clear()
            compiled = [path for path in sorted(_sources(packages[0])) if b"njit" in path.read_bytes()]
            modules = {str(module): file_stats(imported_sources([module], packages)) for module in compiled}
            file.truncate(0)  # first: cut short anywhere after this, everything counts as stale
            for module in compiled:
                if before["modules"].get(str(module)) != modules[str(module)]:
                    for index in (module.parent / "__pycache__").glob(f"{module.stem}.*.nbi"):
                        index.unlink(missing_ok=True)
            json.dump({"all": present, "modules": modules}, file)


def file_stats(paths: Iterable[Path]) -> SourceStats:
    """Return modification time [ns] and size [bytes] of files by path, to detect changes."""
    found = {}
    for path in sorted(paths):
        with contextlib.suppress(FileNotFoundError):  # removed since it was listed
            stat = path.stat()
            found[str(path)] = [stat.st_mtime_ns, stat.st_size]
    return found


def imported_sources(modules: Iterable[Path], packages: tuple[Path, ...]) -> set[Path]:
    """Return the modules and all sources of `packages` that they import, directly or indirectly.

    A package's `__init__` counts if something is imported from it, not as the mere parent of an imported module.
    """
    found: set[Path] = set()
    coming = list(modules)
    while coming:
        module = coming.pop()
        if module not in found:
            found.add(module)
            coming += [path for names in _imports(module) if (path := _source(names, packages))]
    return found


@cache
def _imports(module: Path) -> set[tuple[str, ...]]:
    """Imports of a source as tuples of candidate modules: of `from a import b` the candidates are a.b and a."""
    names: set[tuple[str, ...]] = set()
    for node in ast.walk(ast.parse(module.read_bytes())):
        if isinstance(node, ast.Import):
            names |= {(alias.name,) for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {(f"{node.module}.{alias.name}", node.module) for alias in node.names}
    return names


@cache
def _source(names: tuple[str, ...], packages: tuple[Path, ...]) -> Path | None:
    """Source file of the first name that is a module of `packages`; None: none is."""
    for name in names:
        words = name.split(".")
        for package in packages:
            place = package.parent.joinpath(*words)
            for file in (place.with_suffix(".py"), place / "__init__.py"):
                if words[0] == package.name and file.is_file():
                    return file
    return None


LOG_VARIABLE = "HYDRO_COMPILATIONS"


def record_compilations() -> None:
    """Start logging compilations if `LOG_VARIABLE` is set. Call it once, before anything is compiled."""
    if not (name := os.environ.get(LOG_VARIABLE)):
        return
    file = Path(name)
    from numba.core import event  # takes half a second: only where it is needed

    class Recorder(event.Listener):
        def __init__(self) -> None:
            self.begun: list[float] = []

        def on_start(self, event: Any) -> None:
            self.begun.append(monotonic())

        def on_end(self, event: Any) -> None:
            function, seconds = event.data["dispatcher"].py_func, monotonic() - self.begun.pop()
            line = {
                "program": Path(sys.argv[0]).name,
                "process": os.getpid(),
                "function": f"{function.__module__}.{function.__qualname__}",
                "seconds": round(seconds, 3),
            }
            with file.open("a") as out:  # one short write: lines of several processes do not mix
                out.write(json.dumps(line) + "\n")

    event.register("numba:compile", Recorder())


def read_compilations(file: Path) -> list[dict[str, Any]]:
    """Return the recorded compilations; empty without such a file."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []
