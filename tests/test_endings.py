# SPDX-License-Identifier: Apache-2.0
"""How our executables end when somebody ends them early: one sentence, one status, nothing left."""

from __future__ import annotations

import json
import multiprocessing
import random
import signal
import subprocess
from itertools import repeat
from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_bridge.ros.companion import Companion, executable_path
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


SHORT = "--plant emulator --episodes 1 --exam-every 0 --seed 3 --no-dashboard --ros-args -p task.steps_per_episode:=200"


@pytest.mark.graph
@pytest.mark.study
@pytest.mark.timeout(3600)
@pytest.mark.usefixtures("domain")
def test_twenty_runs_end_with_one_digest_however_busy_the_machine_is(tmp_path: Path) -> None:
    digests = set()
    for k in range(20):
        busy = random.Random(k).randrange(9)
        loops = [multiprocessing.Process(target=sum, args=(repeat(1),), daemon=True) for _ in range(busy)]
        for loop in loops:
            loop.start()
        words = ["--runs", str(tmp_path), "--name", f"run{k}", *SHORT.split()]
        with Companion("hydro_policy", "trainer", words) as run:
            assert run.process.wait(300.0) == 0, run.last_line
        for loop in loops:
            loop.kill()
        digests.add(json.loads((tmp_path / f"run{k}" / "run.json").read_text())["events"][-1]["run_digest"])
    assert len(digests) == 1
