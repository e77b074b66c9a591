# SPDX-License-Identifier: Apache-2.0
"""The process on the serial line (`tests.soak.wire`), from the side of whoever gives it orders."""

from __future__ import annotations

import json
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any


class Wire:
    """The process on the line; see `tests.soak.wire`."""

    def __init__(self, stack: ExitStack, box: Path, bridge: Path, seed: int, *more: str) -> None:
        words = ["--box", str(box), "--bridge", str(bridge), "--seed", str(seed), *more]
        self.process = stack.enter_context(
            subprocess.Popen(
                [sys.executable, "-m", "tests.soak.wire", *words],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
                bufsize=1,
                start_new_session=True,
            )
        )
        stack.callback(self.process.kill)
        assert self.process.stdin is not None and self.process.stdout is not None
        self._orders: IO[str] = self.process.stdin
        self._answers: IO[str] = self.process.stdout

    def order(self, order: str) -> None:
        """Tell it what to do."""
        self._orders.write(f"{order}\n")

    def report(self) -> dict[str, Any]:
        """What has passed."""
        self.order("report")
        return dict(json.loads(self._answers.readline()))


def resident(pid: int) -> float:
    """Memory of a process [MiB]."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024.0
