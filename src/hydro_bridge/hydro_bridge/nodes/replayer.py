# SPDX-License-Identifier: Apache-2.0
"""Publish a recording in the place of the bench, each sample stamped again so that none is stale; it cannot be armed.

ros2 run hydro_bridge replayer BAG [--speed 1.0] [--loop] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterator
from itertools import chain, count, groupby
from operator import itemgetter
from pathlib import Path
from struct import pack
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.task import Future
from std_srvs.srv import SetBool

from hydro_bridge.arguments import ros_arguments
from hydro_bridge.bags.recording import Bag
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status
from hydro_bridge.ros.messages import STATE_CODEC
from hydro_bridge.ros.node import request_realtime, run_node
from hydro_bridge.ros.topics import ARM_SERVICE, BOX, BOX_LAW, CLAIM_SERVICE, LAW_STATE, STATE, create_publisher
from hydro_core.cli.console import UserError, bounded_number, command, make_parser
from hydro_core.signals import Flag
from hydro_msgs.srv import Claim

REPLAYED_TOPICS = (STATE, BOX, LAW_STATE, BOX_LAW)
"""Topics that are replayed, as far as they were recorded; each message has a header."""


def replay(path: Path, publish: Callable[[str, bytes], None], speed: float = 1.0) -> Iterator[None]:
    """Pass the messages of `REPLAYED_TOPICS` to `publish` at their original intervals, each stamped with its due time.

    Each step passes those that are due. Gaps are shortened to 10 s; a clock that was set back is not waited for.
    `speed`: recorded seconds per second, above 0. Raises RecordingError.
    """
    began, began_ns, before, due = time.monotonic(), time.time_ns(), None, 0.0
    for _, pieces in groupby(Bag(path).pieces(), key=lambda piece: id(piece.block)):
        there = [piece for piece in pieces if piece.topic in REPLAYED_TOPICS]
        block = [(log_time, piece.topic, data) for piece in there for log_time, data in piece.serialized()]
        for log_time, topic, data in sorted(block, key=itemgetter(0)):
            due += min(max(1e-9 * (log_time - (before or log_time)), 0.0), 10.0) / speed
            before = log_time
            while time.monotonic() < began + due:
                yield
            stamp = pack("<iI", *divmod(began_ns + int(1e9 * due), 1_000_000_000))  # in little-endian CDR
            publish(topic, data[:4] + stamp + data[12:])


class ReplayerNode(Node):
    """Node that replays a recording, and ends with it."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("replayer")
        self._publishers_by_topic = {topic: create_publisher(self, topic) for topic in REPLAYED_TOPICS}
        self.create_service(SetBool, ARM_SERVICE, self._refuse)
        self.create_service(Claim, CLAIM_SERVICE, self._refuse)
        self.done: Future = Future()
        self._diagnostics = DiagnosticsPublisher(self, lambda: Status(message="replaying", values={}))
        request_realtime(realtime=False)
        passes = count() if options.loop else range(1)
        self._replay = chain.from_iterable(replay(options.bag, self._publish, options.speed) for _ in passes)
        self.create_timer(1e-3, self._publish_due, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.get_logger().info(f"replays {options.bag} as the plant; Ctrl-C ends it")

    def _publish_due(self) -> None:
        try:
            next(self._replay)
        except StopIteration:
            self.done.set_result(None)
        except UserError as error:
            self.done.set_exception(error)

    def _publish(self, topic: str, data: bytes) -> None:
        if topic == STATE and (state := STATE_CODEC.unpack(data)) is not None and state.flags & Flag.PACED:
            data = STATE_CODEC.pack(*state[:-1], state.flags & ~Flag.PACED)  # a recording waits for no answers
        self._publishers_by_topic[topic].publish(data)

    def _refuse(self, request: Any, response: Any) -> Any:
        """Refuse all but disarming."""
        claims = isinstance(request, Claim.Request)
        response.success = request.act == Claim.Request.DISARM if claims else not request.data
        response.message = "disarmed" if response.success else "a recording cannot be armed"
        return response


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("replayer", __doc__)
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder, or .mcap file")
    parser.add_argument("--speed", type=bounded_number(1e-3), default=1.0, help="recorded s per second; default: 1")
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    own, ros = ros_arguments()
    options = parser.parse_args(own)
    next(Bag(options.bag).pieces(), None)  # fails at once if there is nothing to read
    run_node(lambda: ReplayerNode(options), ros)
