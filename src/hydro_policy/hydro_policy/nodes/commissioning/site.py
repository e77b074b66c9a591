# SPDX-License-Identifier: Apache-2.0
"""A site under commissioning: its folder, its plant, and the executables that its gates run on it."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, cast

from hydro_bridge.cli.console import UserError
from hydro_bridge.files import site
from hydro_bridge.ros.companion import Companion
from hydro_policy.commissioning.record import GateError, Record
from hydro_policy.nodes.graph.announcements import print_above_progress

PATIENCE = 30.0
"""s, for an executable that is asked to end: it disarms and completes its recording."""
PORT_WITHIN = 60.0
"""s, for the emulator's port."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """The folder of one bench, and how to run executables on it."""

    folder: Path
    record: Record
    port: str
    arm: str
    """`auto` or `ask`, as `--rearm` of `evaluate`."""
    again: bool
    """Whether it is commissioned anew: a metric of the adopted force law alone will do where that is compensated."""
    policy: bool
    """Whether a policy is to be trained."""
    log: IO[str]
    """Output of all executables."""

    @property
    def bench(self) -> str:
        """File of what the box believes."""
        return str(self.folder / site.BENCH)

    def recording(self, name: str) -> Path:
        """Return the folder of a recording."""
        return self.folder / site.RECORDINGS / name

    def run(self, package: str, executable: str, *words: str, loud: bool = True) -> str:
        """Run an executable to its end; returns its last line.

        Its output goes into the log, and to the terminal if it is `loud`.

        Raises GateError: it did not end with status 0; the reason is its last line.
        """
        self.log.write(f"$ ros2 run {package} {executable} {' '.join(words)}\n")
        output = cast("IO[str]", _Both(self.log, loud=loud))
        running = Companion(package, executable, words, output=output, keys=True)
        try:
            status = running.process.wait()
        except BaseException:
            running.stop(PATIENCE)
            raise
        said = running.last_line
        running.stop()
        if status:
            raise GateError(f"{executable}: {said.removeprefix('error: ') or f'ended with status {status}'}")
        return said

    def start(self, stack: ExitStack, package: str, executable: str, *words: str) -> Companion:
        """Start an executable that `stack` ends."""
        output = cast("IO[str]", _Both(self.log, loud=False))
        return stack.enter_context(Companion(package, executable, words, output=output))

    def evaluate(self, name: str, *words: str, amplitude: float, parameters: Sequence[str] = ()) -> dict[str, Any]:
        """Run `evaluate` under the compensated law, recorded as recordings/NAME; returns its JSON.

        Parameters
        ----------
        name
            Of the recording and of the report.
        words
            Further options.
        amplitude
            Of the sines [N].
        parameters
            Further ROS parameters, name:=value.
        """
        for old in (self.recording(name), self.folder / site.REPORTS / name):
            shutil.rmtree(old, ignore_errors=True)
        given = [f"amplitude:={amplitude:.1f}", *parameters]
        self.run(
            "hydro_policy", "evaluate", "--plant", "bench", "--port", self.port, "--bench", self.bench,
            "--law", "compensated", "--rearm", self.arm, "--no-dashboard", "--record", str(self.recording(name)),
            "--runs", str(self.folder / site.REPORTS), "--name", name, *words,
            "--ros-args", *(word for each in given for word in ("-p", each)),
        )  # fmt: skip
        return read_json(self.folder / site.REPORTS / name / "evaluation.json")


def start_emulator(stack: ExitStack, at: Site, truth: Path | None, seed: int) -> None:
    """Start the emulator on the site's port for as long as `stack` holds (raises UserError where it does not start)."""
    port = Path(at.port)
    port.unlink(missing_ok=True)  # of one that was killed
    words = ["--link", at.port, "--bench", at.bench, "--seed", str(seed), *(["--truth", str(truth)] if truth else [])]
    emulator = at.start(stack, "hydro_sim", "emulator", *words)
    end = time.monotonic() + PORT_WITHIN
    while not port.exists():
        if not emulator.running or time.monotonic() > end:
            raise UserError(f"the emulator does not start: {emulator.last_line.removeprefix('error: ')}")
        time.sleep(0.1)


def read_json(path: Path) -> dict[str, Any]:
    """Read a result (raises GateError where there is none)."""
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise GateError(f"{path} cannot be read: {error}") from None
    return content


class _Both:
    """Output of an executable: the log, and the terminal if it is `loud`."""

    def __init__(self, log: IO[str], *, loud: bool) -> None:
        self._log, self._loud = log, loud

    def write(self, text: str) -> int:
        """Take a line."""
        self._log.write(text)
        if self._loud:
            print_above_progress(text.rstrip("\n"))
        return len(text)

    def flush(self) -> None:
        """The log is read while it grows."""
        self._log.flush()
