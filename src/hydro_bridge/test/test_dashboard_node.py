# SPDX-License-Identifier: Apache-2.0
"""The dashboard as a process, where no plant runs: what it says, refuses, and sends."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import time
from collections.abc import Iterator
from threading import Timer
from typing import Any

import pytest

pytest.importorskip("rclpy")

from websockets.sync.client import ClientConnection, connect

from hydro_bridge.ros.companion import executable_path

pytestmark = pytest.mark.slow

ALONE = {**os.environ, "ROS_DOMAIN_ID": str(1 + (os.getpid() + 50) % 100), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}


def start(*words: str) -> subprocess.Popen[str]:
    path = str(executable_path("hydro_bridge", "dashboard"))
    return subprocess.Popen([path, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=ALONE)


@pytest.fixture(scope="module")
def page() -> Iterator[tuple[ClientConnection, str, int]]:
    process = start("--port", "0")
    late = Timer(60.0, process.kill)
    late.start()
    assert process.stdout is not None
    found = re.search(r"http://127\.0\.0\.1:(\d+)/#token=(\S+)", process.stdout.readline())
    late.cancel()
    assert found
    with connect(f"ws://127.0.0.1:{found[1]}/live") as made:
        yield made, found[2], int(found[1])
    process.send_signal(signal.SIGINT)
    assert process.wait(60.0) == 0
    process.communicate()


def told(page: ClientConnection, kind: str) -> dict[str, Any]:
    """The next text of that kind."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        heard = page.recv(30.0)
        if isinstance(heard, str) and (content := json.loads(heard))["kind"] == kind:
            return dict(content)
    raise AssertionError(f"no {kind}")


def test_without_a_plant_the_page_is_told_so(page: tuple[ClientConnection, str, int]) -> None:
    assert [len(columns) for columns in told(page[0], "hello")["series"]] == [12, 3, 5]
    pulse = told(page[0], "pulse")
    assert pulse["age"] is None and not pulse["alive"] and pulse["epoch"] == "0"


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ({"command": "disarm"}, "no plant runs here"),
        ({"command": "arm", "epoch": "0"}, "no plant runs here"),
        ({"command": "arm", "epoch": "0", "token": "guessed"}, "needs the token"),
        ({"command": "end", "epoch": "1"}, "no plant runs here"),
        ({"command": "open the door"}, "no such command"),
    ],
)
def test_a_command_that_nobody_can_carry_out_is_answered(
    page: tuple[ClientConnection, str, int], command: dict[str, str], said: str
) -> None:
    page[0].send(json.dumps({"token": page[1], "number": 7, **command}))
    answer = told(page[0], "answer")
    assert not answer["success"] and said in answer["text"]
