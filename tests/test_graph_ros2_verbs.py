# SPDX-License-Identifier: Apache-2.0
"""The stand-in's verbs, each against one running graph, which `ros2 launch` and `ros2 run` of the stand-in started."""

from __future__ import annotations

import re
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

from hydro_bridge.bags.recording import read_bag
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


def test_a_graph_is_launched_and_run_shown_called_and_recorded(tmp_path: Path) -> None:
    port, bag = f"port:={tmp_path / 'port'}", str(tmp_path / "bag")
    call = ("service", "call", "/hydro/arm", "std_srvs/srv/SetBool")
    with (
        running("service", "call", "/colour", "std_srvs/srv/Trigger") as refused,
        running("launch", "hydro_sim", "emulator.launch.py", port, "pace:=real") as emulator,
        running("launch", "hydro_bridge", "bridge.launch.py", port, "dashboard:=false") as bridge,
        running("run", "hydro_bridge", "recorder", "--out", bag) as recorder,
    ):
        until(emulator, str(tmp_path / "port"))
        until(recorder, "recording into")
        for process in (emulator, bridge, recorder):  # read on, so that none is ever held up by what it prints
            Thread(target=process.stdout.readlines, daemon=True).start()
        state = yaml.safe_load(ros2("topic", "echo", "/hydro/state", "--once").removesuffix("---\n"))
        assert state["header"]["frame_id"] == "bench" and not state["flags"] & 1
        assert isinstance(state["load_force"], float) and abs(state["header"]["stamp"]["sec"] - time.time()) < 60.0
        latched = yaml.safe_load(ros2("topic", "echo", "/hydro/box", "--once").removesuffix("---\n"))
        assert latched["plant"] == "bridge", "said before"
        assert "/bridge\n" in ros2("node", "list") and "/hydro/state\n" in ros2("topic", "list")
        assert "/hydro/arm [std_srvs/srv/SetBool]\n" in ros2("service", "list", "-t")
        said = ros2(*call, "{data: false}")
        assert "requester: making request: std_srvs.srv.SetBool_Request(data=False)\n" in said
        assert "response:\nstd_srvs.srv.SetBool_Response(success=True, message='disarmed')\n" in said
        assert "success=False" in ros2(*call, "{data: true}"), "nobody arms by this service, by whatever tool"
        assert "nobody offers the service /colour" in refused.communicate(timeout=90)[0] and refused.returncode == 2
        said = ros2("bag", "info", bag)
        assert re.search(r"^Files: +bag_0\.mcap$", said, re.M)
        assert re.search(r"^Duration: +[\d.]+s$", said, re.M)
        found = re.search(r"Topic: /hydro/state \| Type: hydro_msgs/msg/BenchState \| Count: (\d+) \|", said)
        assert found and int(found[1]) > 1000
        assert "was not finished" in said


@pytest.mark.study
def test_the_graph_of_a_training_is_launched_and_ends_in_order_on_an_interrupt(tmp_path: Path) -> None:
    run = tmp_path / "launched"
    words = ("launch", "hydro_policy", "train.launch.py", "plant:=emulator", f"port:={tmp_path / 'port'}")
    with running(*words, f"out:={run}") as process:
        said = until(process, "trainer commands this plant")
        process.send_signal(signal.SIGINT)
        said += process.stdout.readlines()
        assert process.wait(120) == 130
    text = "".join(said)
    for one in ("emulator-1", "bridge-2", "filter-3", "recorder-4", "trainer-5"):
        assert f"[{one}]: process started" in text
    assert "Traceback" not in text
    recorded = read_bag(run / "bag")
    assert recorded.notes == () and len(recorded.state) and not recorded.state["flags"][-1] & 1, "whole, and disarmed"
