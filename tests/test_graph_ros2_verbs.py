# SPDX-License-Identifier: Apache-2.0
"""The stand-in's verbs, each against one running graph, which `ros2 launch` and `ros2 run` of the stand-in started."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

pytest.importorskip("rclpy")

import yaml

from hydro_bridge.bags.recording import read_bag
from tests.checks import ran
from tests.domains import own_domain

pytestmark = pytest.mark.graph

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
    process = subprocess.Popen([*ROS2, *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.communicate(timeout=60)
            except subprocess.TimeoutExpired:
                process.kill()
        process.stdout.close()


def until(process: subprocess.Popen[str], words: str, lines: int = 2000) -> list[str]:
    """What a verb prints up to the line with `words`."""
    said = []
    for line in process.stdout:
        said.append(line)
        if words in line:
            return said
        assert len(said) < lines, "".join(said)
    raise AssertionError(f"it ended without {words!r}: {''.join(said)}")


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Path, Future[Any]]]:
    """Emulator and bridge, launched; a recorder, run. Gives the recording, and a call of a service that nobody offers.

    That is looked for for ten seconds, meanwhile.
    """
    folder = tmp_path_factory.mktemp("graph")
    port, bag = str(folder / "port"), folder / "bag"
    with own_domain(), ExitStack() as stack:
        call = ("service", "call", "/colour", "std_srvs/srv/Trigger")
        refusal = stack.enter_context(ThreadPoolExecutor()).submit(ran, *ROS2, *call, timeout=90)
        emulator = stack.enter_context(
            running("launch", "hydro_sim", "emulator.launch.py", f"port:={port}", "pace:=real")
        )
        until(emulator, port)
        words = ("launch", "hydro_bridge", "bridge.launch.py", f"port:={port}", "dashboard:=false")
        bridge = stack.enter_context(running(*words))
        recorder = stack.enter_context(running("run", "hydro_bridge", "recorder", "--out", str(bag)))
        until(recorder, "recording into")
        for process in (emulator, bridge, recorder):  # read on, so that none is ever held up by what it prints
            Thread(target=process.stdout.readlines, daemon=True).start()
        ros2("topic", "echo", "/hydro/state", "--once")
        yield bag, refusal


def test_a_message_is_shown_as_yaml_and_a_latched_one_though_it_was_said_before(graph: object) -> None:
    state = yaml.safe_load(ros2("topic", "echo", "/hydro/state", "--once").removesuffix("---\n"))
    assert state["header"]["frame_id"] == "bench" and isinstance(state["load_force"], float) and not state["flags"] & 1
    assert yaml.safe_load(ros2("topic", "echo", "/hydro/box", "--once").removesuffix("---\n"))["plant"] == "bridge"
    assert abs(state["header"]["stamp"]["sec"] - time.time()) < 60.0


def test_services_are_listed_and_called(graph: tuple[Path, Future[Any]]) -> None:
    call = ("service", "call", "/hydro/arm", "std_srvs/srv/SetBool")
    assert "/bridge\n" in ros2("node", "list") and "/hydro/state\n" in ros2("topic", "list")
    assert "/hydro/arm [std_srvs/srv/SetBool]\n" in ros2("service", "list", "-t")
    said = ros2(*call, "{data: false}")
    assert "requester: making request: std_srvs.srv.SetBool_Request(data=False)\n" in said
    assert "response:\nstd_srvs.srv.SetBool_Response(success=True, message='disarmed')\n" in said
    assert "success=False" in ros2(*call, "{data: true}"), "nobody arms by this service, by whatever tool"
    answer = graph[1].result()
    assert answer.returncode == 2 and "nobody offers the service /colour" in answer.stderr


def test_a_recording_is_told_of_while_it_grows(graph: tuple[Path, Future[Any]]) -> None:
    said = ros2("bag", "info", str(graph[0]))
    assert re.search(r"^Files: +bag_0\.mcap$", said, re.M)
    assert re.search(r"^Duration: +[\d.]+s$", said, re.M)
    found = re.search(r"Topic: /hydro/state \| Type: hydro_msgs/msg/BenchState \| Count: (\d+) \|", said)
    assert found and int(found[1]) > 1000
    assert "was not finished" in said


@pytest.mark.study
def test_the_graph_of_a_training_is_launched_and_ends_in_order_on_an_interrupt(tmp_path: Path) -> None:
    run = tmp_path / "launched"
    words = ("launch", "hydro_policy", "train.launch.py", "plant:=emulator", f"port:={tmp_path / 'port'}")
    with own_domain(), running(*words, f"out:={run}") as process:
        said = until(process, "trainer commands this plant")
        process.send_signal(signal.SIGINT)
        said += process.stdout.readlines()
        assert process.wait(120) == 130
    text = "".join(said)
    assert [one for one in ("emulator-1", "bridge-2", "filter-3", "recorder-4", "trainer-5")
            if f"[{one}]: process started" not in text] == []  # fmt: skip
    assert "Traceback" not in text
    recorded = read_bag(run / "bag")
    assert recorded.notes == () and len(recorded.state) and not recorded.state["flags"][-1] & 1, "whole, and disarmed"
