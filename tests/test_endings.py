# SPDX-License-Identifier: Apache-2.0
"""How our executables end when somebody ends them early: one sentence, one status, nothing left."""

from __future__ import annotations

import signal
import subprocess
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import executable_path
from tests.checks import wait


@pytest.mark.parametrize(
    ("command", "number"),
    [
        ("hydro_bridge bridge --port /nowhere/port", signal.SIGINT),
        ("hydro_diagnosis diagnose bag --out report", signal.SIGHUP),
    ],
)
def test_ended_while_it_imports_an_executable_says_so_in_a_sentence_and_leaves_nothing(
    command: str, number: signal.Signals, tmp_path: Path
) -> None:
    package, executable, *words = command.split()
    heard = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([str(executable_path(package, executable)), *words], cwd=tmp_path, **heard)

    def answers_hangups() -> int:
        status = Path(f"/proc/{process.pid}/status").read_text().partition("SigCgt:")[2]
        return int(status.split()[0], 16) >> (signal.SIGHUP - 1) & 1

    wait(answers_hangups, 60.0)  # from then on it imports; before, it was Python that started
    process.send_signal(number)
    _, said = process.communicate(timeout=10.0)
    assert process.returncode == 128 + number
    assert said == f"ended by {number.name} while starting: nothing had begun\n"
    assert not list(tmp_path.iterdir())
