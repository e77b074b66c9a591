# SPDX-License-Identifier: Apache-2.0
"""The stand-in's verbs, each against one running graph, which `ros2 run` of the stand-in started."""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest

pytest.importorskip("rclpy")

import yaml

from tests.checks import ran

pytestmark = [pytest.mark.graph, pytest.mark.usefixtures("domain")]

ROS2 = [sys.executable, str(Path(__file__).resolve().parent.parent / "setup" / "ros2.py")]


def ros2(*words: str) -> str:
    """What a verb prints, once it has ended well."""
    answer = ran(*ROS2, *words, timeout=90)
    assert answer.returncode == 0, answer.stderr
    assert answer.stderr == ""
    return answer.stdout


@contextmanager
def running(*words: str) -> Iterator[subprocess.Popen[str]]:
    """A verb that goes on until it is interrupted."""
    with subprocess.Popen([*ROS2, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process:
        try:
            yield process
        finally:
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()


def until(process: subprocess.Popen[str], words: str) -> list[str]:
    """What a verb prints up to the line with `words`."""
    said = []
    for line in process.stdout:
        said.append(line)
        if words in line:
            return said
        assert len(said) < 2000, "".join(said)
    raise AssertionError(f"it ended without {words!r}: {''.join(said)}")


def test_a_graph_is_run_shown_and_called(tmp_path: Path) -> None:
    port = str(tmp_path / "port")
    call = ("service", "call", "/hydro/arm", "std_srvs/srv/SetBool")
    with (
        running("service", "call", "/colour", "std_srvs/srv/Trigger") as refused,
        running("run", "hydro_sim", "emulator", "--link", port, "--pace", "real") as emulator,
        running("run", "hydro_bridge", "bridge", "--port", port) as bridge,
    ):
        until(emulator, port)
        for process in (emulator, bridge):  # read on, so that none is ever held up by what it prints
            Thread(target=process.stdout.readlines, daemon=True).start()
        state = yaml.safe_load(ros2("topic", "echo", "/hydro/state", "--once").removesuffix("---\n"))
        assert state["header"]["frame_id"] == "bench" and not state["flags"] & 1
        assert isinstance(state["load_force"], float) and abs(state["header"]["stamp"]["sec"] - time.time()) < 60.0
        latched = yaml.safe_load(ros2("topic", "echo", "/hydro/box", "--once").removesuffix("---\n"))
        assert latched["plant"] == "bridge", "said before"
        assert "/bridge\n" in ros2("node", "list")
        assert "/hydro/state [hydro_msgs/msg/BenchState]\n" in ros2("topic", "list", "-t")
        with running("topic", "hz", "/hydro/state") as rate:
            assert "average rate: " in until(rate, "average rate: ")[-1]
        assert float(ros2("param", "get", "/bridge", "silence_max")) == 1.0
        refusal = ran(*ROS2, "param", "set", "/bridge", "silence_max", "2.0", timeout=90)
        assert refusal.returncode == 2 and "read-only" in refusal.stderr
        said = ros2(*call, "{data: false}")
        assert "requester: making request: std_srvs.srv.SetBool_Request(data=False)\n" in said
        assert "response:\nstd_srvs.srv.SetBool_Response(success=True, message='disarmed')\n" in said
        assert "success=False" in ros2(*call, "{data: true}"), "nobody arms by this service, by whatever tool"
        assert "nobody offers /colour" in refused.communicate(timeout=90)[0] and refused.returncode == 2
