# SPDX-License-Identifier: Apache-2.0
"""Steps that say when they begin and what they took, and commands whose output goes to a log."""

from __future__ import annotations

import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path


class SetupError(Exception):
    """What stopped the set-up, as one sentence for the person at the terminal."""


class Steps:
    """Steps, two of which may run at a time.

    Each is announced when it begins, and its time when it ends well. At a terminal the last line shows the steps that
    are waited for, and the newest line of the log of the one that began last.
    """

    def __init__(self) -> None:
        self._started = time.monotonic()
        self._running: dict[str, Path] = {}
        self._lock = threading.Lock()
        self._ended = threading.Event()
        self._display = threading.Thread(target=self._show, daemon=True)

    @contextmanager
    def step(self, title: str, log: Path) -> Iterator[None]:
        """Announce a step whose output goes to `log`."""
        began = time.monotonic()
        self._running[title] = log
        self.say(f"{title} ...")
        try:
            yield
            self.say(f"{title}: {time.monotonic() - began:.0f} s")
        finally:
            del self._running[title]

    def __enter__(self) -> Steps:
        """Show what is waited for, at a terminal."""
        if sys.stdout.isatty():
            self._display.start()
        return self

    def __exit__(self, *_: object) -> None:
        """Take the display away."""
        self._ended.set()
        if self._display.is_alive():
            self._display.join()

    def say(self, line: str) -> None:
        """Print a line with the time since the set-up began."""
        with self._lock:
            clear = "\r\x1b[K" if sys.stdout.isatty() else ""
            print(f"{clear}[{time.monotonic() - self._started:3.0f} s] {line}", flush=True)

    def _show(self) -> None:
        while not self._ended.wait(0.5):
            running = list(self._running.items())
            titles = " and ".join(title for title, _ in running)
            newest = [line for _, log in running for line in lines(log)][-1:]
            text = ": ".join([f"[{time.monotonic() - self._started:3.0f} s] waits for {titles}", *newest])
            with self._lock:
                print(f"\r{text[: shutil.get_terminal_size().columns - 1]}\x1b[K", end="", flush=True)
        print("\r\x1b[K", end="", flush=True)


def run_logged(
    command: Sequence[str], log: Path, environment: Mapping[str, str], hint: str = "", folder: Path | None = None
) -> None:
    """Run `command`, in `folder`, with its output in `log`.

    Raises SetupError if it exits other than 0; the sentence quotes what went wrong and names the log.
    """
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("wb") as out:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=out, stderr=subprocess.STDOUT, env=environment, cwd=folder
        )
        try:
            process.wait()
        except BaseException:
            process.terminate()
            process.wait()
            raise
    if process.returncode != 0:
        raise SetupError(f"{_spell(command)} failed: {_complaint(log)}. {hint}The whole output is in {log}.")


def lines(log: Path) -> list[str]:
    """Return the lines of a log that are not blank; none where it is not there yet."""
    if not log.exists():
        return []
    return [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]


def _complaint(log: Path) -> str:
    written = lines(log)
    errors = [line for line in written if line.lower().startswith(("error", "fatal", "cmake error"))]
    return (errors or written or ["no output"])[-1][:300].rstrip(".")


def _spell(command: Sequence[str]) -> str:
    words = [Path(command[0]).name, *command[1:]]
    return "`" + " ".join(words[:5]) + (" ...`" if len(words) > 5 else "`")
