# SPDX-License-Identifier: Apache-2.0
"""Steps that say where they stand, and commands whose output goes to a log."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path


class SetupError(Exception):
    """What stopped the set-up, as one sentence for the person at the terminal."""


class Steps:
    """Number the steps and time them: `[2/4] install the pinned wheels ... 41 s`."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._done = 0

    @contextmanager
    def step(self, title: str) -> Iterator[None]:
        """Announce a step, and its time when it ends well."""
        self._done += 1
        print(f"[{self._done}/{self._total}] {title} ...", end="", flush=True)
        started = time.monotonic()
        try:
            yield
        except BaseException:
            print(flush=True)
            raise
        print(f" {time.monotonic() - started:.0f} s", flush=True)


def run_logged(command: Sequence[str], log: Path, environment: Mapping[str, str], hint: str = "") -> None:
    """Run `command` with its output in `log`; while a person watches, a dot a few seconds apart says that it lives.

    Raises
    ------
    SetupError
        If it exits other than 0; the sentence ends with the last line it wrote and the name of the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as output:
        process = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT, env=dict(environment))
        try:
            _wait(process)
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if process.returncode != 0:
        raise SetupError(f"{_spell(command)} failed ({_last_line(log)}). {hint}The whole output is in {log}.")


def _wait(process: subprocess.Popen[bytes], every: float = 5.0) -> None:
    while True:
        try:
            process.wait(timeout=every)
            return
        except subprocess.TimeoutExpired:
            if sys.stdout.isatty():
                print(".", end="", flush=True)


def _spell(command: Sequence[str]) -> str:
    words = [Path(command[0]).name, *command[1:]]
    return "`" + " ".join(words[:5]) + (" ...`" if len(words) > 5 else "`")


def _last_line(log: Path) -> str:
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if line.lower().startswith(("error", "fatal"))]
    return (errors or lines or ["no output"])[-1][:300]
