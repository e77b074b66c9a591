# SPDX-License-Identifier: Apache-2.0
"""Replay of a recording in place of a plant: it publishes the recorded messages, and cannot be armed.

ros2 run hydro_bridge replayer BAG [--speed 1.0] [--loop] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import threading
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from std_srvs.srv import SetBool

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.bags.replaying import Replay
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.cli.console import command
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status
from hydro_bridge.ros.node import request_realtime, ros_arguments, run_node
from hydro_bridge.ros.topics import ARM_SERVICE, BOX, BOX_LAW, CLAIM_SERVICE, GRAPH, LAW_STATE, STATE
from hydro_msgs.srv import Claim


class ReplayerNode(Node):
    """Publishes a recording in a separate thread, and ends with it."""

    def __init__(self, options: argparse.Namespace) -> None:
        super().__init__("replayer")
        self._bag = options.bag
        self._publishers_by_topic = {topic: self.create_publisher(*_kind(topic)) for topic in options.topics}
        self.create_service(SetBool, ARM_SERVICE, self._refuse_to_arm)
        self.create_service(Claim, CLAIM_SERVICE, self._refuse_authority)
        self.replay = Replay(
            options.bag,
            options.topics,
            lambda topic, data: self._publishers_by_topic[topic].publish(data),
            speed=options.speed,
            loop=options.loop,
        )
        self.failure: Exception | None = None
        self.done: Future = Future()
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        request_realtime(realtime=False)
        self._thread = threading.Thread(target=self._run, name="replay", daemon=True)

    def begin(self) -> None:
        """Start replaying."""
        self.get_logger().info(f"replays {self._bag} as the plant; Ctrl-C ends it")
        self._thread.start()

    def close(self) -> None:
        """Stop replaying."""
        self.replay.stop()
        if self._thread.is_alive():
            self._thread.join(2.0)

    def _run(self) -> None:
        try:
            self.replay.run()
        except RecordingError as error:
            self.failure = error
        self.get_logger().info(f"{self.replay.published} messages replayed")
        self.done.set_result(None)

    def _refuse_to_arm(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        response.success = not request.data
        response.message = "a recording cannot be armed" if request.data else "disarmed"
        return response

    def _refuse_authority(self, request: Claim.Request, response: Claim.Response) -> Claim.Response:
        response.success = request.act == Claim.Request.DISARM
        response.message = "disarmed" if response.success else "a recording cannot be armed"
        return response

    def _status(self) -> Status:
        values = {"published": self.replay.published, "late [s]": self.replay.latest}
        return Status(message="replaying", values=values)


def _kind(topic: str) -> tuple[type[Any], str, QoSProfile]:
    if topic not in GRAPH:
        raise RecordingError(f"{topic} is no topic of the hydro graph: use `ros2 bag play`")
    kind, qos = GRAPH[topic]
    return kind, topic, qos


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="replayer",
        description="Publish a recording in the place of the bench: filter, trainer and recorder see the same topics.",
        epilog="`ros2 bag play BAG` works too; this one stamps each sample anew, so that none is taken for stale.",
    )
    parser.add_argument("bag", type=Path, metavar="BAG", help="rosbag2 folder, or .mcap file")
    parser.add_argument("--speed", type=float, default=1.0, help="recorded seconds per second (default: %(default)s)")
    parser.add_argument("--loop", action="store_true", help="begin again at the end")
    usual = [STATE, BOX, LAW_STATE, BOX_LAW]
    parser.add_argument(
        "--topics", nargs="+", default=usual, metavar="TOPIC", help=f"default, as far as recorded: {' '.join(usual)}"
    )
    return parser


@command()
def main() -> None:
    """Entry point."""
    own, ros = ros_arguments()
    options = _parser().parse_args(own)
    read_bag(options.bag, topics=())  # fails at once if there is nothing to read
    nodes: list[ReplayerNode] = []

    def make() -> ReplayerNode:
        nodes.append(ReplayerNode(options))
        return nodes[0]

    run_node(make, ros)
    if nodes[0].failure is not None:
        raise nodes[0].failure
