# SPDX-License-Identifier: Apache-2.0
"""Run each package's `precompile.STEPS`, a process per core: `make setup` calls this in the set-up environment."""

from __future__ import annotations

import argparse
import fcntl
import importlib
import json
import multiprocessing
import os
import signal
import sys
import tempfile
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

from numba.core import caching

from hydro_sim import compiled

PACKAGES = ("hydro_policy", "hydro_sim", "hydro_filter", "hydro_diagnosis")
"""In whose `precompile` the steps are."""

MAIN_JOB = (("hydro_filter", "filter"), ("hydro_policy", "learner"), ("hydro_policy", "estimator"),
            ("hydro_sim", "emulator"))  # fmt: skip
"""Package and step of what `make train` runs, the longest first."""

FOLDERS = ("hydro_core", "hydro_bridge", "hydro_sim", "hydro_filter", "hydro_policy", "hydro_diagnosis")
"""Packages whose sources count."""

PROCESSES = 4
"""At most: each takes half a gigabyte."""

BAR = 20
"""Characters."""


def main() -> None:
    """Compile, and write down what that read and what it left."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--machine", required=True, help="written into the stamp")
    parser.add_argument("--main-job", action="store_true", help="only what the main job needs")
    parser.add_argument("--stamp", type=Path, required=True, help="file to write")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda number, frame: sys.exit(128 + number))  # `run_all` ends its processes
    packages = {package for package, _ in MAIN_JOB} if options.main_job else PACKAGES
    modules = {package: importlib.import_module(f"{package}.precompile") for package in packages}
    folders = tuple(Path(str(importlib.import_module(name).__file__)).resolve().parent for name in FOLDERS)
    sources = compiled.file_stats(
        compiled.imported_sources([Path(str(m.__file__)).resolve() for m in modules.values()], folders)
    )
    steps = dict.fromkeys(MAIN_JOB)
    if not options.main_job:
        steps |= dict.fromkeys((package, step) for package, module in modules.items() for step in module.STEPS)
    run_all(list(steps))
    compiled_files = (path for folder in folders for kind in ("*.nbi", "*.so") for path in folder.rglob(kind))
    caches = sorted(str(path) for path in compiled_files if "__pycache__" in path.parts)
    part = options.stamp.with_suffix(".part")
    part.write_text(json.dumps({"machine": options.machine, "sources": sources, "caches": caches}))
    part.replace(options.stamp)


def run_all(steps: Sequence[tuple[str, str]]) -> None:
    """Run (package, step) side by side, and say how far it is."""
    # Forked, not by `jobs`, which spawns: the packages are imported once. Nothing runs yet that a fork would break.
    context = multiprocessing.get_context("fork")
    with (
        tempfile.NamedTemporaryFile() as lock,
        ProcessPoolExecutor(min(PROCESSES, len(os.sched_getaffinity(0))), context, save_alone, (lock.name,)) as pool,
    ):
        names = {pool.submit(run, package, step): step for package, step in steps}
        try:
            for done, future in enumerate(as_completed(names), 1):
                future.result()
                filled = BAR * done // len(steps)
                print(f"[{'#' * filled}{'.' * (BAR - filled)}] {done}/{len(steps)}  {names[future]}", flush=True)
        except BaseException:  # what has begun would be waited for, and what has not, be done
            pool.shutdown(wait=False, cancel_futures=True)
            for child in multiprocessing.active_children():
                child.kill()
            raise


def run(package: str, step: str) -> None:
    """Run one step."""
    importlib.import_module(f"{package}.precompile").STEPS[step]()


def save_alone(lock: str) -> None:
    """Let only one process at a time save into numba's caches.

    Two that save signatures of one function at once would take the same file for both, and the index would name the
    one that holds the other.
    """
    save = caching.IndexDataCacheFile.save

    def alone(self: Any, key: Any, data: Any) -> None:
        with open(lock) as file:
            fcntl.flock(file, fcntl.LOCK_EX)
            save(self, key, data)

    caching.IndexDataCacheFile.save = alone


if __name__ == "__main__":
    main()
