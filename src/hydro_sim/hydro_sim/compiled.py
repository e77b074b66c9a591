# SPDX-License-Identifier: Apache-2.0
"""Keeps numba's caches honest when several modules are compiled into one another.

numba recompiles a cached function when the function's own file changes, not when a function it calls does: after an
edit of `hydraulics.py` the cached `plant.advance` would go on with the old equations. `forget_stale` empties a
package's caches whenever any of its sources, or of the packages it calls into, has changed.

A function with fastmath must not call a cached one without: numba compiles that one with the caller's fastmath if it
comes first, and caches it so, for every other caller.
"""

from __future__ import annotations

import contextlib
import fcntl
from pathlib import Path

STAMP = "sources.stamp"


def forget_stale(*packages: Path) -> bool:
    """Delete the cached compilations under the first folder if a source under any of the folders changed since.

    Call it in a package's `__init__`, before its compiled modules load. Where the folder cannot be written numba keeps
    its caches elsewhere, and nothing is done: sources that cannot be written do not change.

    Returns
    -------
    Whether anything was deleted.
    """
    stamp = packages[0] / "__pycache__" / STAMP
    sources = [path.stat() for package in packages for path in sorted(package.rglob("*.py"))]
    present = repr([(source.st_mtime_ns, source.st_size) for source in sources])
    with contextlib.suppress(OSError):
        stamp.parent.mkdir(exist_ok=True)
        with stamp.open("a+") as file:
            # A graph starts its nodes at once: the second must not delete what the first has just compiled.
            fcntl.flock(file, fcntl.LOCK_EX)
            file.seek(0)
            if file.read() == present:
                return False
            for index in packages[0].rglob("*.nbi"):
                index.unlink(missing_ok=True)
            file.truncate(0)
            file.write(present)
            return True
    return False
