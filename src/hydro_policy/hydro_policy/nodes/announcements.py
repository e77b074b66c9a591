# SPDX-License-Identifier: Apache-2.0
"""User messages of a node and its companion processes on terminal and log; typed lines; supervision of companions."""

from __future__ import annotations

import math
import queue
import re
import signal
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO

from hydro_bridge.ros.companion import Companion
from hydro_core.cli.console import print_above_progress


@dataclass
class RepeatFilter:
    """Rate limiter for messages: passes the first few occurrences of a sentence, numbers aside, and counts the rest."""

    count_max: int  # largest number of occurrences of a sentence within 10 s
    occurrences: dict[str, tuple[float, int]] = field(default_factory=dict)
    """Start of the period and count, by sentence."""

    def filter(self, sentence: str) -> str:
        """Return the sentence, with the number of similar ones omitted before it; empty: it is to be omitted."""
        now, kind = time.monotonic(), re.sub(r"[\d.]+", "", sentence)
        since, count = self.occurrences.get(kind, (-math.inf, 0))
        if now - since > 10.0:
            self.occurrences[kind] = (now, 1)
            left_out = count - self.count_max
            return f"{sentence} ({left_out} more since the last one)" if left_out > 0 else sentence
        self.occurrences[kind] = (since, count + 1)
        return sentence if count < self.count_max else ""


@dataclass
class Announcer:
    """Output of a trainer or an evaluation to terminal and log; failures of either never stop the run."""

    journal: Callable[[str, bool], None]  # publisher of sentences for recordings
    log: IO[str] | None = None  # destination of sentences besides the terminal
    repeat_filter: RepeatFilter = field(default_factory=lambda: RepeatFilter(8))

    def report(self, sentence: str, warning: bool = False) -> None:
        """Print a sentence, with an exclamation mark if it is a warning."""
        told = self.repeat_filter.filter(f"! {sentence}" if warning else sentence)
        if not told:
            return
        print_above_progress(told)
        self.journal(told.removeprefix("! "), warning)
        if self.log is not None:
            self.write_log(f"{time.strftime('%H:%M:%S')} {told}\n")

    def write_log(self, line: str) -> None:
        """Write a line into the log; a write error ends the log only."""
        if self.log is None or self.log.closed:
            return
        log = self.log
        try:
            log.write(line)
        except OSError as error:
            self.log = None
            with suppress(OSError):  # closing would write again
                log.close()
            print_above_progress(f"! the log ends here: {error.strerror}")


def companion_output(keep: Callable[[str], None]) -> Callable[[str], None]:
    """Return a handler of a companion's output lines: passes each to `keep`, and prints warnings and errors."""
    repeat_filter, warnings = RepeatFilter(1), ("warn", "error", "fatal", "traceback", "bypass")

    def take(text: str) -> None:
        keep(text)
        if any(word in text.lower() for word in warnings) and (line := repeat_filter.filter(text.rstrip("\n"))):
            print_above_progress(line)

    return take


def terminal_lines() -> queue.SimpleQueue[str]:
    """Return a queue of the lines typed on the terminal from now on; it stays empty without a terminal."""
    lines: queue.SimpleQueue[str] = queue.SimpleQueue()

    def read() -> None:
        with suppress(OSError, ValueError):  # the terminal was closed
            for line in sys.stdin:
                lines.put(line)

    if sys.stdin is not None and sys.stdin.isatty():
        threading.Thread(target=read, daemon=True).start()
    return lines


@dataclass
class CompanionWatch:
    """Watch over companion processes: reports each unexpected end once."""

    running: list[Companion]
    unrecorded: str = "acting goes on unrecorded"  # consequence of the recorder's end, for the message
    refused: str = ""
    """Message of a companion that rejected its input, and will not return; empty: none."""
    lost: str = ""  # message about an essential companion that ended, and its consequence
    recording: str = "not by this run"  # state of the recording, for the live page

    def poll(self) -> list[str]:
        """Return a sentence about each companion that has ended since the last call."""
        gone = [companion for companion in self.running if not companion.running]
        self.running = [companion for companion in self.running if companion not in gone]
        told = []
        for companion in gone:
            code, outcome = companion.process.returncode, "no samples come, and the box disarms itself"
            if companion.name == "recorder":
                outcome = self.unrecorded
                self.recording = "LOST: end the run, or let it go on unrecorded"
            status = f"killed by {signal.Signals(-code).name}" if code < 0 else f"exit status {code}"
            told.append(f"{companion.name} ended by itself ({status}): {outcome}")
            if code == 2:  # invalid input
                said = companion.last_line.removeprefix("error: ").removeprefix(f"{companion.name}: ")
                self.refused = self.refused or f"{companion.name}: {said}"
            elif companion.name != "recorder":
                self.lost = self.lost or told[-1]
        return told
