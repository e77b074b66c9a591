# SPDX-License-Identifier: Apache-2.0
"""What strangers do to an armed plant, and what it does then: the table of authority.md.

Emulator, bridge and filter run; a commander tracks 200 N at 1 Hz with (90, 15). A stranger, a participant of its own,
then publishes two hundred messages a second, without the epoch of the session or with it copied from the graph.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import rclpy
from std_srvs.srv import SetBool

from hydro_bridge.ros import topics
from hydro_bridge.ros.messages import reference_to_message
from hydro_bridge.ros.node import DISCOVERY_RANGE_VARIABLE, FASTDDS_PROFILES_VARIABLE
from hydro_bridge.ros.topics import STATE, create_publisher
from hydro_core.signals import CorrectionStatus, Flag, ReferenceSignal, Waveform
from hydro_msgs.msg import Authority, BenchState, Correction, Gains
from hydro_msgs.srv import Claim
from hydro_policy.nodes.plant_options import PlantOptions
from hydro_policy.nodes.plants import GRAPH_FILE, plant_graph, start_nodes
from hydro_policy.task.mdp import GainRange
from tests.graph_probe import Probe

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0)
SHAKE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=8.0)
_LASTS = 2.0  # s that an attack lasts, if the plant stays armed
AFTER = 0.1
"""s from the disarm in which the force error still counts."""
Strike = Callable[[Any, Any], Callable[[], bool]]
"""What a stranger's node does to a graph (`Defended`, or as much of it as is known): once more; whether it arrives."""


class Defended:
    """The graph under attack."""

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.text: list[str] = []
        graph = plant_graph(PlantOptions(plant="emulator"), GainRange(), folder)
        self.companions = start_nodes(stack, folder / GRAPH_FILE, graph, self.text.append)
        self.probe = Probe()
        stack.callback(self.probe.close)
        self.probe.commands = True
        states, ready = (
            self.probe.heard[STATE],
            lambda: not self.probe.flags() & Flag.FILTER_STALE and len(states) > 100,
        )
        self.probe.wait(lambda: self.probe.commander.holds_lease and ready(), 120.0, required=False)
        assert self.probe.commander.holds_lease and ready(), (self.probe.commander.holds_lease, len(states), self.text)

    @property
    def epoch(self) -> int:
        """Of the session, as anybody can read it from the graph."""
        return self.probe.commander.epoch

    @property
    def sequence(self) -> int:
        """Of the plant's latest sample."""
        return self.probe.last(STATE).sequence if self.probe.heard[STATE] else 0

    def subscribers(self, topic: str) -> int:
        """How many listen to a topic."""
        return int(self.probe.node.count_subscribers(topic))

    def arm(self) -> None:
        """Arm, and track until the force has come to its reference."""
        self.probe.arm(False)
        self.probe.commander.publish_reference(SINE)
        deadline = time.monotonic() + 60.0
        while not self.probe.ask(True).success:  # a stranger that has just left is forgotten soon
            assert time.monotonic() < deadline, "it cannot be armed"
            self.drive(0.3)
        self.drive(2.0)
        assert self.probe.flags() & Flag.ARMED

    def valve_closed_at(self) -> float:
        """Drive until the valve current is 0 for good; when its first such sample arrived, s of `time.time`."""
        driven = lambda state: bool(state.flags & Flag.ARMED) or state.valve_current != 0.0  # noqa: E731
        self.drive(10.0, until=lambda: not driven(self.probe.last(STATE)))
        self.drive(0.5)
        heard = self.probe.heard[STATE]
        last = max(n for n, (_, state) in enumerate(heard) if driven(state))
        assert last + 1 < len(heard), "it is closed"
        return heard[last + 1][0] + time.time() - time.monotonic()

    def own_flags(self) -> int:
        """Flags of the plant's latest sample."""
        own = [state for state in self.probe.states[-50:] if state.header.frame_id == "bench"]
        return int(own[-1].flags) if own else int(Flag.ARMED)

    def drive(
        self, seconds: float, besides: Callable[[], None] = lambda: None, until: Callable[[], bool] = lambda: False
    ) -> None:
        """Publish gains at 100 Hz, and do `besides` at 200 Hz."""
        end, due, next_one = time.monotonic() + seconds, 0.0, 0.0
        while (now := time.monotonic()) < end and not until():
            if now >= due:
                due = now + 0.01
                self.probe.commander.publish_gains(75.0, 10.0)
                self.probe.commander.renew_lease(now)
            if now >= next_one:
                next_one = now + 0.005
                besides()
            self.probe._executor.spin_once(timeout_sec=0.001)

    def attack(self, strike: Strike) -> tuple[float, float, list[tuple[float, BenchState]]]:
        """Arm, track, and let a stranger strike.

        Returns the largest force error [N] in the second before; when the stranger's messages could arrive first [s];
        the plant's samples from then on, with the times [s] at which they were heard.
        """
        self.arm()
        before = error(self.probe.states[-1000:])
        self.probe.forget()
        began: list[float] = []
        with stranger() as node:
            arrives = strike(node, self)

            def besides() -> None:
                if arrives() and not began:
                    began.append(time.monotonic())

            self.drive(_LASTS, besides, lambda: not self.own_flags() & Flag.ARMED)
            self.drive(2 * AFTER, besides)
        own = [(when, state) for when, state in self.probe.heard[STATE] if state.header.frame_id == "bench"]
        return before, began[0] if began else time.monotonic(), own


def error(states: list[BenchState]) -> float:
    """Largest |f_r - f_l| [N] of the reference that the holder has chosen."""
    return max((abs(state.reference_force - state.load_force) for state in states), default=0.0)


@contextmanager
def stranger() -> Iterator[Any]:
    """A node of a participant of its own."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("stranger", context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.shutdown(context=context)


LISTEN = """
import sys, time, rclpy
from hydro_bridge.ros.topics import STATE, create_subscription
rclpy.init()
node, heard = rclpy.create_node("tool"), []
time.sleep(1.5)
create_subscription(node, STATE, heard.append)
end = time.monotonic() + 5.0
while len(heard) < 200 and time.monotonic() < end:
    rclpy.spin_once(node, timeout_sec=0.1)
sys.exit(len(heard) < 200)
"""
"""A tool as `ros2 topic echo` is: it has joined for a while when it subscribes, which is when a writer waits for it."""


@contextmanager
def listener(reach: str) -> Iterator[subprocess.Popen[bytes]]:
    """A tool of its own process that knows no profile of ours, hears 200 states and ends with 0."""
    environment = {name: value for name, value in os.environ.items() if name != FASTDDS_PROFILES_VARIABLE}
    process = subprocess.Popen([sys.executable, "-c", LISTEN], env=environment | {DISCOVERY_RANGE_VARIABLE: reach})
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def _publishing(topic: str, message: Callable[[Any], Any]) -> Strike:
    """A stranger that publishes on a topic."""

    def strike(node: Any, graph: Any) -> Callable[[], bool]:
        publisher = create_publisher(node, topic)

        def once() -> bool:
            publisher.publish(message(graph))
            return bool(publisher.get_subscription_count() >= graph.subscribers(topic))

        return once

    return strike


def _calling(kind: Any, service: str, request: Any) -> Strike:
    """A stranger that calls a service, once."""

    def strike(node: Any, graph: Any) -> Callable[[], bool]:
        client = node.create_client(kind, service)
        called: list[Any] = []

        def once() -> bool:
            if not called and client.service_is_ready():
                called.append(client.call_async(request))
            return bool(called)

        return once

    return strike


def _pushing(graph: Any) -> Correction:
    status = int(CorrectionStatus.MODIFIED)
    return Correction(sequence=graph.sequence, delta_u=0.05, status=status, epoch=graph.epoch)


def _false_state(graph: Any) -> BenchState:
    state = BenchState(sequence=7, load_force=600.0, reference_force=-600.0, flags=int(Flag.TRIPPED))
    state.header.frame_id = "false"
    return state


DISARMS = "/hydro/arm false"
"""Done by anybody, after which a person has to arm again."""
ATTACKS: dict[str, Strike] = {
    "gains, no epoch": _publishing(topics.GAINS, lambda graph: Gains(delta_kp=50.0)),
    "gains, epoch copied": _publishing(topics.GAINS, lambda graph: Gains(delta_kp=50.0, epoch=graph.epoch)),
    "reference, epoch copied": _publishing(topics.REFERENCE, lambda graph: reference_to_message(SHAKE, graph.epoch)),
    "correction 50 mA, epoch copied": _publishing(topics.CORRECTION, _pushing),
    "correction, cut off": _publishing(topics.CORRECTION, lambda graph: bytes(20)),
    "states": _publishing(STATE, _false_state),
    "authority": _publishing(topics.AUTHORITY, lambda graph: Authority(holder="stranger", claim=1, epoch=1)),
    "/hydro/arm true": _calling(SetBool, topics.ARM_SERVICE, SetBool.Request(data=True)),
    DISARMS: _calling(SetBool, topics.ARM_SERVICE, SetBool.Request(data=False)),
    "/hydro/claim take": _calling(Claim, topics.CLAIM_SERVICE, Claim.Request(act=Claim.Request.TAKE, name="stranger")),
}
STAYS_ARMED = frozenset({"/hydro/arm true", "/hydro/claim take"})
"""What is refused, and changes nothing."""
