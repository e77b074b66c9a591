# SPDX-License-Identifier: Apache-2.0
"""Replay of a recording in place of a plant: it publishes the recorded messages, and cannot be armed.

ros2 run hydro_bridge replayer BAG [--speed 1.0] [--loop] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import threading
import time
from collections.abc import Callable
from pathlib import Path
from struct import Struct
from threading import Event
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from hydro_bridge.bags.monotonic_times import MonotonicTimes
from hydro_bridge.bags.recording import read_bag, read_serialized
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status
from hydro_bridge.ros.messages import STATE_CODEC
from hydro_bridge.ros.node import request_realtime, ros_arguments, run_node
from hydro_bridge.ros.topics import ARM_SERVICE, BOX, BOX_LAW, CLAIM_SERVICE, LAW_STATE, STATE, create_publisher
from hydro_core.cli.console import bounded_number, command
from hydro_core.signals import Flag
from hydro_msgs.srv import Claim

_STAMP_FORMAT = Struct("<iI")
REPLAYED_TOPICS = (STATE, BOX, LAW_STATE, BOX_LAW)
"""Topics that are replayed, as far as they were recorded; each message has a header."""
GAP_MAX = 10.0
"""Longest gap [s] between two messages that is replayed; longer ones are skipped."""


def replay(
    path: Path,
    publish: Callable[[str, bytes], None],
    stopping: Event,
    speed: float = 1.0,
    note: Callable[[str], None] = lambda sentence: None,
) -> None:
    """Pass the messages of `REPLAYED_TOPICS` to `publish` at their original intervals, each stamped with its due time.

    Returns at the end of the recording, or once `stopping` is set. `speed`: recorded seconds per second, above 0.
    `note`: called with a sentence on each gap that is skipped. Raises RecordingError.
    """
    clock, first, told = MonotonicTimes(GAP_MAX), None, 0
    began, began_ns = time.monotonic(), time.time_ns()
    for topic, _, log_time, data in read_serialized(path):
        if topic not in REPLAYED_TOPICS:
            continue
        now = float(clock.convert(np.array([1e-9 * log_time]))[0])
        first = now if first is None else first
        for when, step in clock.jumps[told:]:
            note(f"the recording's clock goes {step:+.10g} s after {when - first:.1f} s: that is left out")
        told = len(clock.jumps)
        ahead = (now - first) / speed
        if stopping.wait(max(0.0, began + ahead - time.monotonic())):
            return
        stamp = _STAMP_FORMAT.pack(*divmod(began_ns + int(1e9 * ahead), 1_000_000_000))  # in little-endian CDR
        publish(topic, data[:4] + stamp + data[12:])


class ReplayerNode(Node):
    """Node that replays a recording in a separate thread, and ends with it."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("replayer")
        self._bag, self._speed, self._loop = options.bag, options.speed, options.loop
        self._publishers_by_topic = {topic: create_publisher(self, topic) for topic in REPLAYED_TOPICS}
        self.create_service(SetBool, ARM_SERVICE, self._refuse)
        self.create_service(Claim, CLAIM_SERVICE, self._refuse)
        self._published, self._stopping = 0, Event()
        self.done: Future = Future()
        self._diagnostics = DiagnosticsPublisher(
            self, lambda: Status(message="replaying", values={"published": self._published})
        )
        request_realtime(realtime=False)
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)

    def begin(self) -> None:
        """Start replaying."""
        self.get_logger().info(f"replays {self._bag} as the plant; Ctrl-C ends it")
        self._thread.start()

    def close(self) -> None:
        """Stop replaying."""
        self._stopping.set()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        try:
            again = True
            while again and not self._stopping.is_set():
                replay(self._bag, self._publish, self._stopping, self._speed, self.get_logger().warning)
                again = self._loop
        except RecordingError as error:
            self.done.set_exception(error)
        else:
            self.done.set_result(None)
        self.get_logger().info(f"{self._published} messages replayed")

    def _publish(self, topic: str, data: bytes) -> None:
        if topic == STATE and (state := STATE_CODEC.unpack(data)) is not None and state.flags & Flag.PACED:
            data = STATE_CODEC.pack(*state[:-1], state.flags & ~Flag.PACED)  # a recording waits for no answers
        self._publishers_by_topic[topic].publish(data)
        self._published += 1

    def _refuse(self, request: Any, response: Any) -> Any:
        """Refuse all but disarming, by either service."""
        claims = isinstance(request, Claim.Request)
        response.success = request.act == Claim.Request.DISARM if claims else not request.data
        response.message = "disarmed" if response.success else "a recording cannot be armed"
        return response


@command()
def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(
        prog="replayer",
        description="Publish a recording in the place of the bench: filter, trainer and recorder see the same topics.",
        epilog="`ros2 bag play BAG` works too; this one stamps each sample again, so that none is taken for stale.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder, or .mcap file")
    parser.add_argument(
        "--speed", type=bounded_number(1e-3), default=1.0, help="recorded s per second (default: %(default)s)"
    )
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    own, ros = ros_arguments()
    options = parser.parse_args(own)
    read_bag(options.bag, topics=())  # fails at once if there is nothing to read
    run_node(lambda: ReplayerNode(options), ros)
