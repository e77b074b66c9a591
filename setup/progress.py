# SPDX-License-Identifier: Apache-2.0
"""Steps that say where they stand, and commands whose output goes to a log."""

from __future__ import annotations

import shutil
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


def run_logged(
    command: Sequence[str], log: Path, environment: Mapping[str, str], hint: str = "", folder: Path | None = None
) -> None:
    """Run `command`, in `folder`, with its output in `log`; whoever watches sees the time and the last line of it.

    Raises SetupError if it exits other than 0; the sentence quotes what went wrong and names the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, env=environment, cwd=folder
        )
        try:
            _wait(process, log)
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if process.returncode != 0:
        raise SetupError(f"{_spell(command)} failed: {_complaint(log)}. {hint}The whole output is in {log}.")


def _wait(process: subprocess.Popen[bytes], log: Path) -> None:
    started = time.monotonic()
    while True:
        try:
            process.wait(timeout=0.5)
        except subprocess.TimeoutExpired:
            _show(f"{time.monotonic() - started:4.0f} s  {(_lines(log) or [''])[-1]}")
        else:
            _show("")
            return


def _show(text: str) -> None:
    """Write behind the cursor and leave it where it is."""
    if sys.stdout.isatty():
        width = max(0, shutil.get_terminal_size().columns - 60)
        print(f"\x1b7 {text[:width]}\x1b[K\x1b8", end="", flush=True)


def _lines(log: Path) -> list[str]:
    return [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]


def _complaint(log: Path) -> str:
    lines = _lines(log)
    errors = [line for line in lines if line.lower().startswith(("error", "fatal", "cmake error"))]
    return (errors or lines or ["no output"])[-1][:300].rstrip(".")


def _spell(command: Sequence[str]) -> str:
    words = [Path(command[0]).name, *command[1:]]
    return "`" + " ".join(words[:5]) + (" ...`" if len(words) > 5 else "`")
