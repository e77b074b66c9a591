# SPDX-License-Identifier: Apache-2.0
"""The sim as users start it. That it can stand for emulator and bridge: tests/test_graph_plants.py."""

from __future__ import annotations

import threading
from collections.abc import Iterator

import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.experimental import EventsExecutor  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402

from hydro_bridge.ros.companion import Companion  # noqa: E402
from hydro_bridge.ros.messages import seconds  # noqa: E402
from hydro_bridge.ros.topics import AUTHORITY, CORRECTION, GRAPH, STATE  # noqa: E402
from hydro_msgs.msg import Authority, BenchState, Correction  # noqa: E402

pytestmark = pytest.mark.graph


@pytest.fixture
def lock_step() -> Iterator[None]:
    sim = Companion("hydro_sim", "sim", ["--speed", "0"])
    yield
    sim.stop()


def test_lock_step_waits_for_the_filter_and_publishes_the_clock(lock_step: None) -> None:
    """A filter that answers at once: no sample is lost, and each comes with its time on /clock."""
    context = rclpy.Context()
    rclpy.init(context=context)
    node = rclpy.create_node("probe", context=context)
    answer = node.create_publisher(Correction, CORRECTION, GRAPH[CORRECTION][1])
    states: list[tuple[int, float]] = []
    times: list[float] = []
    enough = rclpy.task.Future()

    def on_state(message: BenchState) -> None:
        answer.publish(Correction(header=message.header, sequence=message.sequence, epoch=epochs[-1] if epochs else 0))
        if not states or message.sequence != states[-1][0]:  # sent again where this process was kept waiting
            states.append((message.sequence, seconds(message.header.stamp)))

    def on_clock(message: Clock) -> None:
        times.append(seconds(message.clock))
        if len(states) >= 1500 and times[-1] >= states[1499][1] and not enough.done():
            enough.set_result(None)

    epochs: list[int] = []
    node.create_subscription(Authority, AUTHORITY, lambda m: epochs.append(m.epoch), GRAPH[AUTHORITY][1])
    node.create_subscription(BenchState, STATE, on_state, GRAPH[STATE][1])
    node.create_subscription(Clock, "/clock", on_clock, 1000)
    executor = EventsExecutor(context=context)
    executor.add_node(node)
    watch = threading.Timer(60.0, lambda: enough.set_result(None))
    watch.start()
    while not enough.done():
        executor.spin_until_future_complete(enough, timeout_sec=0.2)
    watch.cancel()
    executor.shutdown()
    node.destroy_node()
    rclpy.shutdown(context=context)
    answered, stamps = [sequence for sequence, _ in states[500:1500]], [stamp for _, stamp in states[500:1500]]
    assert answered == list(range(answered[0], answered[0] + 1000))
    assert stamps == pytest.approx([1e-3 * sequence for sequence in answered])
    assert set(times) >= set(stamps)
