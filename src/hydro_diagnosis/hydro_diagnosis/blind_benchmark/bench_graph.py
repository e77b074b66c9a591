# SPDX-License-Identifier: Apache-2.0
"""Recordings over the serial line: emulator, bridge, `collect` and recorder as processes, in real time.

The recordings pass through the same chain as a bench's samples. The graph stays on this machine, and in its own
domain unless ROS_DOMAIN_ID is set.
"""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from hydro_bridge.cli.console import UserError, progress
from hydro_bridge.process.endings import undisturbed
from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD, Case
from hydro_diagnosis.blind_benchmark.recording import clear, fresh, run_seed, whole, written
from hydro_diagnosis.blind_benchmark.retake import ATTEMPTS, Attempt, usable

DOMAIN = "78"
TRIPPED = 3
"""Exit status of `collect` after repeated trips; `usable` decides whether the run can be used."""
PATIENCE = 60.0
"""Time [s] that a recording may take beyond its own length."""


def record_by_graph(cases: Sequence[Case], folder: Path, until: float) -> bool:
    """Record the missing runs of `cases` as `recording.record` does; return False if time was up."""
    runs = [(case, name) for case in cases for name in (*FITTED, HELD) if not whole(folder / case.name / name)]
    for case, name in progress(runs, label="recording over the serial line", unit="run"):
        if time.monotonic() > until:
            return False
        bag = folder / case.name / name
        for attempt in ATTEMPTS:
            _play(case, name, attempt, clear(bag))
            if usable(fresh(bag)):
                break
        fresh(bag).rename(bag)
    return True


def _play(case: Case, name: str, attempt: Attempt, bag: Path) -> None:
    with tempfile.TemporaryDirectory(prefix="hydro-truth-") as scratch:
        paths, port = written(case, name, attempt, Path(scratch)), str(Path(scratch) / "port")
        emulator = ["hydro_sim", "emulator", "--link", port, "--truth", paths["truth"]]
        believed = ["--bench", paths["bench"]] if "bench" in paths else []
        emulator += believed
        bridge = ["hydro_bridge", "bridge", "--port", port, "--ros-args", "-p", "guard.require_filter:=false"]
        with _running([*emulator, "--seed", str(run_seed(case, name))]), _running(bridge):
            words = ["--out", str(bag), "--schedule", paths["schedule"], *believed]
            _collect(words, case.schedules[name]["seconds"])


def _collect(words: Sequence[str], seconds: float) -> None:
    """Play the schedule and record; raises UserError if it does not come to its end."""
    command = ["ros2", "run", "hydro_sim", "collect", *words]
    try:
        done = subprocess.run(
            command, check=False, capture_output=True, text=True, env=_environment(), timeout=seconds + PATIENCE
        )
    except subprocess.TimeoutExpired:
        raise UserError("the graph did not come to the end of a recording: the same command tries it again") from None
    if done.returncode not in (0, TRIPPED):
        raise UserError(f"collect failed: {(done.stderr.strip() or 'it was ended').splitlines()[-1]}")


@contextmanager
def _running(words: Sequence[str]) -> Iterator[None]:
    """Run an executable of the workspace beside this process and end it as Ctrl-C would."""
    process = subprocess.Popen(
        ["ros2", "run", *words], env=_environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        start_new_session=True,
    )  # fmt: skip
    try:
        yield
    finally:
        with undisturbed():  # a second Ctrl-C leaves nothing behind
            os.killpg(process.pid, signal.SIGINT)
            try:
                process.wait(timeout=10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _environment() -> dict[str, str]:
    return {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_DOMAIN_ID": DOMAIN, **os.environ}
