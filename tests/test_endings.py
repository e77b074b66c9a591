# SPDX-License-Identifier: Apache-2.0
"""How our executables end when somebody ends them early: one sentence, one status, nothing left."""

from __future__ import annotations

import signal
import subprocess
import time
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import executable_path

ENDED = (
    ("hydro_bridge", "bridge", signal.SIGINT, "--port", "/nowhere/port"),
    ("hydro_policy", "trainer", signal.SIGTERM, "--plant", "external"),
    ("hydro_diagnosis", "diagnose", signal.SIGHUP, "bag", "--out", "report"),
)


def answers(process: subprocess.Popen[str], number: int) -> bool:
    """Whether the process has a handler for the signal."""
    status = Path(f"/proc/{process.pid}/status").read_text()
    caught = next(line for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught.split()[1], 16) >> (number - 1) & 1)


def test_ended_while_it_imports_an_executable_says_so_in_a_sentence_and_leaves_nothing(tmp_path: Path) -> None:
    heard = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    for package, executable, number, *words in ENDED:
        command = [str(executable_path(package, executable)), *words]
        process = subprocess.Popen(command, cwd=tmp_path, **heard)
        while not answers(process, signal.SIGHUP):  # from then on it imports; before, it was Python that started
            assert process.poll() is None
            time.sleep(1e-3)
        process.send_signal(number)
        _, said = process.communicate(timeout=10.0)
        assert process.returncode == 128 + number, executable
        assert said == f"ended by {signal.Signals(number).name} while starting: nothing had begun\n"
    assert not list(tmp_path.iterdir())
