# SPDX-License-Identifier: Apache-2.0
"""What the whole-graph tests share: a node that watches, and a trainer as users start it."""

from __future__ import annotations

import os
import subprocess
import time
from collections import defaultdict
from collections.abc import Callable
from contextlib import AbstractContextManager, suppress
from typing import Any

import psutil
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.ros.topics import ARM_SERVICE, CLAIM_SERVICE, DIAGNOSTICS, GAINS, STATE, TRAINING, create_subscription
from hydro_core.signals import Flag
from hydro_msgs.srv import Claim

SHORT = ("--ros-args", "-p", "task.steps_per_episode:=300", "-p", "learning_starts:=100", "-p", "exam.every:=0")
"""Words of a trainer whose episodes are short."""


class Probe:
    """Hears states, gains and training status; arms as a person does, and commands the plant when told to."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = rclpy.create_node("probe", context=self.context)
        self.heard: dict[str, list[tuple[float, Any]]] = {}
        for topic in (STATE, GAINS, TRAINING):
            messages = self.heard[topic] = []
            create_subscription(self.node, topic, lambda m, heard=messages: heard.append((time.monotonic(), m)))
        self.told = defaultdict[str, dict[str, str]](dict)
        """Latest diagnostics by name: values by key, and `message`."""
        create_subscription(self.node, DIAGNOSTICS, self._note)
        self.commander = Commander(self.node)
        self.commands = False
        """Whether it keeps the authority."""
        self.graph: dict[str, dict[str, Any]] = {}
        """What the nodes were started with."""
        self.arming = self.node.create_client(Claim, CLAIM_SERVICE)
        self.disarming = self.node.create_client(SetBool, ARM_SERVICE)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

    def _note(self, array: DiagnosticArray) -> None:
        for status in array.status:
            self.told[status.name] = {pair.key: pair.value for pair in status.values} | {"message": status.message}

    def spin(self, seconds: float) -> None:
        """Let messages come in for so long."""
        self.wait(lambda: False, seconds, required=False)

    def wait(self, condition: Callable[[], object], timeout: float = 30.0, *, required: bool = True) -> None:
        """Let messages come in until `condition` holds; fails after `timeout` seconds."""
        end = time.monotonic() + timeout
        while not condition():
            if time.monotonic() > end:
                assert not required, "waited in vain"
                return
            self._executor.spin_once(timeout_sec=0.02)
            if self.commands:
                self.commander.renew_lease(time.monotonic())

    def drive(
        self, delta_kp: float, delta_ki: float, seconds: float, until: Callable[[], object] = lambda: False
    ) -> float:
        """Publish gains at 100 Hz for so many seconds, or `until`; the longest time [s] between two messages."""
        longest, last = 0.0, time.monotonic()
        end = last + seconds
        while last < end and not until():
            self.commander.publish_gains(delta_kp, delta_ki)
            self.spin(0.01)
            last, before = time.monotonic(), last
            longest = max(longest, last - before)
        return longest

    def drive_to(self, delta_kp: float, delta_ki: float, gain: float, seconds: float = 60.0) -> None:
        """Publish gains until the plant has this K_p: a busy machine that holds gains up gets base gains meanwhile."""
        reached = lambda: bool(self.states) and self.last(STATE).proportional_gain == gain  # noqa: E731
        self.drive(delta_kp, delta_ki, seconds, reached)
        assert reached(), f"K_p {self.last(STATE).proportional_gain} in place of {gain}"

    def take(self, timeout: float = 30.0) -> None:
        """Take the lease over the plant, and keep it."""
        self.commands = True
        self.wait(lambda: self.commander.holds_lease, timeout)

    def ask(self, arm: bool) -> Any:
        """The plant's answer to a request to arm, by name, or to disarm."""
        client = self.arming if arm else self.disarming
        self.wait(client.service_is_ready)
        request = Claim.Request(act=Claim.Request.ARM, name="probe") if arm else SetBool.Request(data=False)
        answer = client.call_async(request)
        self.wait(answer.done)
        return answer.result()

    def arm(self, arm: bool) -> None:
        """Ask the plant until it confirms: a box in real time that a busy machine holds up is not armed at once."""
        answer = self.ask(arm)
        end = time.monotonic() + 30.0
        while not answer.success and time.monotonic() < end:
            self.spin(0.2)
            answer = self.ask(arm)
        assert answer.success, answer.message
        self.wait(lambda: bool(self.flags() & Flag.ARMED) == arm)

    @property
    def states(self) -> list[Any]:
        return [message for _, message in self.heard[STATE]]

    def last(self, topic: str) -> Any:
        return self.heard[topic][-1][1]

    def flags(self) -> int:
        """Flags of the latest sample; 0 before the first."""
        return int(self.last(STATE).flags) if self.heard[STATE] else 0

    def forget(self) -> None:
        for messages in self.heard.values():
            messages.clear()

    def close(self) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


def children(parent: int, word: str) -> list[int]:
    """Process ids of the children whose command line holds `word`."""
    found = []
    with suppress(psutil.NoSuchProcess):
        for process in psutil.Process(parent).children():
            with suppress(psutil.NoSuchProcess):  # it ends just now
                found += [process.pid] if word in " ".join([*process.cmdline(), ""]) else []
    return found


class Trainer(AbstractContextManager["Trainer"]):
    """A trainer with its companions, in a process group of its own; `stdin`: the descriptor that it reads."""

    def __init__(self, *words: str, stdin: int = subprocess.DEVNULL) -> None:
        self._said = os.memfd_create("said")
        command = [str(executable_path("hydro_policy", "trainer")), *words]
        self.process = subprocess.Popen(
            command, stdin=stdin, stdout=self._said, stderr=subprocess.STDOUT, start_new_session=True
        )

    def __exit__(self, *_: object) -> None:
        self.process.terminate()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(30.0)
        self.process.kill()
        print(self.text)

    @property
    def text(self) -> str:
        """What it has printed."""
        return os.pread(self._said, 1 << 24, 0).decode(errors="replace")

    def child(self, word: str) -> int:
        """Process id of the one child whose command line holds `word`."""
        (found,) = children(self.process.pid, word)
        return found
