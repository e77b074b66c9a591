# SPDX-License-Identifier: Apache-2.0
"""The stand-in `ros2`, on an ament prefix made for the test."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

ROS2 = Path(__file__).resolve().parent.parent / "setup" / "ros2.py"


@pytest.fixture
def environment(tmp_path: Path) -> dict[str, str]:
    """A prefix with one package, `rig`, and its executables."""
    index = tmp_path / "share" / "ament_index" / "resource_index" / "packages"
    index.mkdir(parents=True)
    (index / "rig").touch()
    folder = tmp_path / "lib" / "rig"
    folder.mkdir(parents=True)
    for name, body in {"echo": 'echo "$$: $@"; exit 7', "wait": "echo ready; exec sleep 60"}.items():
        (folder / name).write_text(f"#!/bin/sh\n{body}\n")
        (folder / name).chmod(0o755)
    (folder / "notes.txt").write_text("not an executable")
    return {**os.environ, "AMENT_PREFIX_PATH": str(tmp_path)}


def ros2(environment: dict[str, str], *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROS2), *arguments]
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False, timeout=60)


def test_run_hands_over_arguments_process_and_exit_status(environment: dict[str, str]) -> None:
    command = [sys.executable, str(ROS2), "run", "rig", "echo", "--ros-args", "-p", "speed:=0", "two words"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        out, _ = process.communicate(timeout=60)
    assert out == f"{process.pid}: --ros-args -p speed:=0 two words\n"
    assert process.returncode == 7
    assert ros2(environment, "pkg", "executables", "rig").stdout == "rig echo\nrig wait\n"


def test_interrupt_reaches_the_node(environment: dict[str, str]) -> None:
    command = [sys.executable, str(ROS2), "run", "rig", "wait"]
    with subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=10) == -signal.SIGINT


def refuses(environment: dict[str, str], words: Sequence[str], sentence: str) -> None:
    answer = ros2(environment, *words)
    assert (answer.returncode, answer.stdout) == (2, "")
    assert sentence in answer.stderr and answer.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["run", "nothing", "echo"], "package 'nothing' not found"),
        (["run", "rig", "ech"], "no executable 'ech'; it has: echo, wait"),
        (["doctor"], "`ros2 doctor` needs a full ROS 2 Jazzy"),
    ],
)
def test_what_it_cannot_do_it_says_in_a_sentence(
    environment: dict[str, str], arguments: list[str], sentence: str
) -> None:
    refuses(environment, arguments, sentence)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("service", "call", "/hydro/arm", "std_srvs/srv/SetBool", "{dat: 1}"), "has no field dat; it has: data"),
        (("service", "call", "/hydro/arm", "std_srvs/srv/SetBool", "{data: 1}"), "data: 1 is no boolean"),
        (("bag", "info", "/nothing"), "/nothing does not exist"),
        (("launch", "hydro_bridge", "bridge.launch.py"), "port:= is needed: serial device of the box"),
        (("launch", "hydro_policy", "train.launch.py", "plant:=moon"), "sim, emulator, bench can be chosen"),
    ],
)
def test_before_the_graph_is_asked_what_is_wrong_is_a_sentence(words: tuple[str, ...], sentence: str) -> None:
    refuses(dict(os.environ), words, sentence)
