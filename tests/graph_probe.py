# SPDX-License-Identifier: Apache-2.0
"""What the whole-graph tests share: a node that watches, and a trainer as users start it."""

from __future__ import annotations

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import SingleThreadedExecutor
from std_srvs.srv import SetBool

from hydro_bridge.ros.commander import Commander
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.ros.topics import ARM_SERVICE, CLAIM_SERVICE, GAINS, GRAPH, STATE, TRAINING
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
        self.heard: dict[str, list[tuple[float, Any]]] = {topic: [] for topic in (STATE, GAINS, TRAINING)}
        for topic, messages in self.heard.items():
            kind, qos = GRAPH[topic]
            self.node.create_subscription(
                kind, topic, lambda m, heard=messages: heard.append((time.monotonic(), m)), qos
            )
        self.commander = Commander(self.node)
        self.commands = False
        """Whether it keeps the authority."""
        self.arming = self.node.create_client(Claim, CLAIM_SERVICE)
        self.disarming = self.node.create_client(SetBool, ARM_SERVICE)
        self._executor = SingleThreadedExecutor(context=self.context)
        self._executor.add_node(self.node)

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
            self.commander.gains(delta_kp, delta_ki)
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
        self.wait(lambda: self.commander.held, timeout)

    def wait_for(self, topic: str, wanted: Callable[[Any], object], timeout: float = 30.0) -> Any:
        """Let messages come in until one of a topic is `wanted`; returns the first that is."""
        heard = self.heard[topic]
        self.wait(lambda: any(wanted(message) for _, message in heard[-50:]), timeout)
        return next(message for _, message in heard if wanted(message))

    def ask(self, arm: bool) -> Any:
        """The plant's answer to a request to arm, by name, or to disarm."""
        client = self.arming if arm else self.disarming
        self.wait(client.service_is_ready)
        request = Claim.Request(act=Claim.Request.ARM, name="probe") if arm else SetBool.Request(data=False)
        answer = client.call_async(request)
        self.wait(answer.done)
        return answer.result()

    def arm(self, arm: bool) -> None:
        """Ask the plant, and wait until it confirms."""
        answer = self.ask(arm)
        assert answer.success, answer.message
        self.wait(lambda: bool(self.flags() & Flag.ARMED) == arm)

    @property
    def states(self) -> list[Any]:
        """Samples that were heard."""
        return [message for _, message in self.heard[STATE]]

    def last(self, topic: str) -> Any:
        """The latest message of a topic."""
        return self.heard[topic][-1][1]

    def flags(self) -> int:
        """Flags of the latest sample; 0 before the first."""
        return int(self.last(STATE).flags) if self.heard[STATE] else 0

    def forget(self) -> None:
        """Drop what was heard."""
        for messages in self.heard.values():
            messages.clear()

    def close(self) -> None:
        """Leave the graph."""
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


class Trainer:
    """A trainer with its companions, in a process group of its own.

    `stdin`: the descriptor that it reads; none by default.
    """

    def __init__(self, *words: str, stdin: int = subprocess.DEVNULL) -> None:
        self._said = os.memfd_create("said")
        self.process = subprocess.Popen(
            [str(executable_path("hydro_policy", "trainer")), *words],
            stdin=stdin,
            stdout=self._said,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )

    @property
    def text(self) -> str:
        """What it has printed."""
        return os.pread(self._said, 1 << 24, 0).decode(errors="replace")

    def child(self, word: str) -> int:
        """Process id of the one child whose command line holds `word`."""
        found = [pid for pid in _children(self.process.pid) if word in _command_line(pid)]
        assert len(found) == 1, f"{word}: {[_command_line(pid) for pid in _children(self.process.pid)]}"
        return found[0]

    def end(self, number: int = signal.SIGINT, timeout: float = 40.0) -> int:
        """Send a signal, and wait for the exit status."""
        self.process.send_signal(number)
        return self.process.wait(timeout)


@contextmanager
def trainer(*words: str, stdin: int = subprocess.DEVNULL) -> Iterator[Trainer]:
    """Start a trainer, and be sure that it is gone in the end."""
    run = Trainer(*words, stdin=stdin)
    try:
        yield run
    finally:
        run.process.terminate()
        with suppress(subprocess.TimeoutExpired):
            run.process.wait(30.0)
        run.process.kill()
        print(run.text)


def _children(pid: int) -> list[int]:
    tasks = Path(f"/proc/{pid}/task").iterdir()
    return [int(child) for task in tasks for child in (task / "children").read_text().split()]


def _command_line(pid: int) -> str:
    return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
