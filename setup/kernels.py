# SPDX-License-Identifier: Apache-2.0
"""Compile the numerical kernels ahead of every run, and tell whether that is done.

numba keeps what it has compiled beside the sources and starts again where a source, the Python or the processor is
another. What the warm-up read and left is written into a stamp; while all of it is as it was, nothing has to be done.
"""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path

from setup import stamp, workspace
from setup.layout import Layout
from setup.progress import run_logged

RECORDING = "HYDRO_COMPILATIONS"
"""The environment variable by which `hydro_sim.compiled` writes down what a run compiles: this is none."""

HINT = "`make lint` says what is wrong with a source that was edited. "


def machine_digest(wheels_digest: str) -> str:
    """Digest of what compiled code depends on besides the sources."""
    cache = os.environ.get("NUMBA_CACHE_DIR", "")
    return stamp.digest([wheels_digest, f"cache {cache}", f"processor {_processor()}"])


def are_current(layout: Layout, machine: str, main_job: bool) -> bool:
    """Say whether all kernels, or those of the main job, are compiled, of the sources as they are."""
    stamps = (layout.kernels_stamp(False), *([layout.kernels_stamp(True)] if main_job else []))
    return any(_is_current(path, machine) for path in stamps)


def _is_current(path: Path, machine: str) -> bool:
    try:
        found = json.loads(path.read_text())
        sources = {path: [(stat := os.stat(path)).st_mtime_ns, stat.st_size] for path in found["sources"]}
    except (OSError, ValueError, KeyError):
        return False
    return bool(
        found["machine"] == machine and sources == found["sources"] and all(map(os.path.exists, found["caches"]))
    )


def compile_steps(layout: Layout, machine: str, environment: Mapping[str, str], main_job: bool, log: Path) -> None:
    """Compile what is not compiled yet, in processes of the environment, and write the stamp.

    Colcon may still build the packages: they are imported by `workspace.link_sources`. Raises SetupError: a kernel
    cannot be compiled.
    """
    target = layout.kernels_stamp(main_job)
    target.unlink(missing_ok=True)
    quiet = {name: value for name, value in environment.items() if name != RECORDING}
    for name, folders in (
        ("PYTHONPATH", workspace.link_sources(layout)),
        ("AMENT_PREFIX_PATH", [str(layout.install / "hydro_firmware")]),
    ):
        quiet[name] = os.pathsep.join(filter(None, [*folders, quiet.get(name)]))
    words = ["-m", "setup.compile_kernels", "--machine", machine, "--stamp", str(target)]
    words += ["--main-job"] if main_job else []
    run_logged([str(layout.python), *words], log, quiet, HINT, layout.root)


def _processor() -> str:
    """What numba compiles for: model and features of the first core."""
    try:
        first = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        return "unknown"
    return "\n".join(line for line in first if line.startswith(("model name", "flags", "Features")))
