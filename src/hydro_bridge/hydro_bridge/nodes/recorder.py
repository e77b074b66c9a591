# SPDX-License-Identifier: Apache-2.0
"""Record the graph into a rosbag2 folder (MCAP). End it with Ctrl-C or SIGTERM.

ros2 run hydro_bridge recorder --out DIR [--metadata KEY=VALUE] [--attach FILE] [--ros-args ...]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from functools import partial
from operator import itemgetter
from pathlib import Path
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future

from hydro_bridge.arguments import parse_arguments, ros_arguments
from hydro_bridge.bags.repair import repair
from hydro_bridge.bags.writer import BagWriter, code_version
from hydro_bridge.plant_clock import RECORDER_WINDOW
from hydro_bridge.ros.acknowledgement import SampleAcknowledger
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Level, Status, warn_of_duplicate_nodes
from hydro_bridge.ros.messages import STATE_CODEC
from hydro_bridge.ros.node import request_realtime, run_node
from hydro_bridge.ros.topics import RECORDED_TOPICS, STATE, Mailbox, type_name
from hydro_bridge.serial.stream import SequenceTracker
from hydro_core.cli.console import command, make_parser, writable_folder
from hydro_core.signals import Flag

_QUEUE_DEPTH = 2000  # queued messages per topic while the disk is slow: 2 s of samples


class RecorderNode(Node):
    """Fetches serialized messages and writes them unchanged, until writing fails.

    Log times are times of arrival. Where the plant runs by its own clock they begin at the first sample's arrival and
    advance with each sample, so that the recording has the plant's duration.

    A write error ends the recording with one sentence, `failed` set and `done` completed.
    """

    def __init__(self, make_writer: Callable[[], BagWriter], *, realtime: bool) -> None:
        super().__init__("recorder")
        # nice: below all control nodes; the middleware buffers some 0.5 s of samples, then drops them
        scheduling = request_realtime(realtime=realtime, nice=-10)  # before samples arrive
        self._writer, self._messages = make_writer(), dict.fromkeys(RECORDED_TOPICS, 0)
        self._tracker, self._newest, self.failed = SequenceTracker(), -1, False
        self.done: Future = Future()
        self._mailbox, self._heard = Mailbox("recorder"), dict[str, Subscription]()
        for topic, (kind, offered) in RECORDED_TOPICS.items():
            reliable = offered.reliability == ReliabilityPolicy.RELIABLE
            latched = offered.durability == DurabilityPolicy.TRANSIENT_LOCAL
            self._writer.add_topic(topic, type_name(kind), depth=offered.depth, reliable=reliable, latched=latched)
            qos = QoSProfile(depth=_QUEUE_DEPTH, reliability=offered.reliability, durability=offered.durability)
            self._heard[topic] = self._mailbox.subscribe(topic, kind, qos)
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(0.05, self._fetch, clock=steady)
        self.create_timer(0.5, partial(self._write, self._writer.flush), clock=steady)  # the loss through `kill -9`
        warn_of_duplicate_nodes(self, f"another recorder runs here: both go on, this one in {self._writer.folder}")
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        self._answers, self._answered = SampleAcknowledger(self, RECORDER_WINDOW, self._heard[STATE]), -1
        self._paced, self._offset, self._now = False, 0, 0  # ns: log time minus stamp of a paced plant, last log time
        self.get_logger().info(f"recording into {self._writer.folder}; {scheduling}")

    def close(self) -> None:
        """Finish the recording; a failed one is left unfinished, readable like that of a killed recorder."""
        self._fetch()
        self._mailbox.close()
        self._write(self._writer.close)
        topics = ", ".join(f"{count} {topic}" for topic, count in self._messages.items() if count) or "no messages"
        self.get_logger().info(f"{self._writer.folder}: {topics}; {self._tracker.counts.lost} samples lost")

    def _fetch(self) -> None:
        """Write the arrived messages by time of arrival, and acknowledge the samples to a paced plant."""
        arrived = [(time_ns, topic, data) for topic, subscription in self._heard.items()
                   for data, time_ns in self._mailbox.fetch(subscription, _QUEUE_DEPTH)]  # fmt: skip
        for time_ns, topic, data in sorted(arrived, key=itemgetter(0)):
            self._write(self._take, topic, data, time_ns)
        if self._paced and self._newest != self._answered:
            self._answers.acknowledge(self._newest)
            self._answered = self._newest

    def _take(self, topic: str, data: bytes, time_ns: int) -> None:
        if topic == STATE and (state := STATE_CODEC.unpack(data)) is not None:
            self._newest = state.sequence
            self._tracker.accept(state.sequence)
            before, self._paced = self._paced, bool(state.flags & Flag.PACED)
            if self._paced and (not before or state.stamp + self._offset < self._now):
                self._offset = max(time_ns, self._now) - state.stamp
            self._now = state.stamp + self._offset if self._paced else time_ns
        self._writer.write(topic, data, self._now if self._paced else time_ns)
        self._messages[topic] += 1

    def _write(self, write: Callable[..., None], *what: object) -> None:
        if self.failed:
            return
        try:
            write(*what)
        except OSError as error:
            self.failed = True
            stopped = f"{self._writer.folder}: recording stopped: {error.strerror}"
            self.get_logger().error(f"{stopped}: free disk space and start another one")
            self.done.set_result(None)

    def _status(self) -> Status:
        lost = self._tracker.counts.lost
        message = f"{sum(self._messages.values())} messages, {lost} samples lost"
        values = {"folder": self._writer.folder, "lost": lost, **self._messages}
        return Status(level=Level.WARN if lost else Level.OK, message=message, values=values)


def _pair(text: str) -> str:
    if "=" not in text:
        raise argparse.ArgumentTypeError(f"{text!r} must be KEY=VALUE")
    return text


@command(OSError)
def main() -> int:
    """Entry point; exit status 1 if writing failed."""
    parser = make_parser("recorder", __doc__)
    action = parser.add_mutually_exclusive_group(required=True)
    action.add_argument("--out", type=writable_folder, metavar="DIR", help="folder to make; it must not exist")
    action.add_argument("--repair", type=Path, metavar="DIR", help="make a recording whole whose recorder was killed")
    several: dict[str, Any] = {"nargs": "+", "action": "extend", "default": []}
    parser.add_argument("--metadata", **several, type=_pair, metavar="KEY=VALUE", help="kept in the recording")
    parser.add_argument("--attach", **several, type=Path, metavar="FILE", help="kept too, e.g. bench.yaml")
    parser.add_argument("--realtime", action="store_true", help="run before ordinary processes, if this user may")
    own, ros = ros_arguments()
    options = parse_arguments(parser, "recorder", own, ros)
    if options.repair:
        count, notes = repair(options.repair)
        print("\n".join([f"{options.repair}: kept {count} messages", *notes]), file=sys.stderr)
        return 0
    metadata = {"code_version": code_version(), **dict(pair.split("=", 1) for pair in options.metadata)}
    attachments = {path.name: path.read_bytes() for path in options.attach}
    writer = partial(BagWriter, options.out, metadata=metadata, attachments=attachments)
    return int(run_node(lambda: RecorderNode(writer, realtime=options.realtime), ros, [options]).failed)
