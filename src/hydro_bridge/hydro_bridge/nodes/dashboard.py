# SPDX-License-Identifier: Apache-2.0
"""Serves the live page of the graph that runs: look at it, disarm it; with the token, arm and override it.

ros2 run hydro_bridge dashboard                  # prints the page's address, with the token behind #
ros2 run hydro_bridge dashboard --port 8080
"""

from __future__ import annotations

import secrets
import time
from collections import Counter
from concurrent.futures import Future as Promise
from concurrent.futures import InvalidStateError
from contextlib import suppress
from functools import partial
from importlib import resources
from math import inf
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.client import Client
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.task import Future
from std_srvs.srv import SetBool, Trigger

from hydro_bridge.bags.cdr import fixed_layout
from hydro_bridge.pages import environment
from hydro_bridge.pages.commands import (
    COMMAND_SIZE_MAX,
    PageCommand,
    RefusedError,
    answer_commands,
    authorize,
)
from hydro_bridge.pages.series import (
    BIN_WIDTH,
    SERIES_COLUMNS,
    LiveSeries,
    column_descriptions,
    column_values,
    encode_bins,
)
from hydro_bridge.pages.server import HOST, PORT, PageServer, encode_message
from hydro_bridge.pages.status import PHASES, LearningCurve, flag_labels
from hydro_bridge.ros import topics
from hydro_bridge.ros.diagnostics import DiagnosticsPublisher, Status, warn_of_duplicate_nodes
from hydro_bridge.ros.messages import subscribe_to_box
from hydro_bridge.ros.node import request_realtime, ros_arguments, run_node
from hydro_bridge.ros.topics import Mailbox, create_subscription
from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.cli.console import bounded_number, command, make_parser
from hydro_core.signals import CorrectionStatus
from hydro_msgs.msg import Authority, TrainingStatus
from hydro_msgs.srv import Claim, OverrideGains

QUEUE_DEPTH = 500
"""Depth of the message queue of each topic until the next frame: half a second."""
PLANT_TIMEOUT = 0.5
"""s without a sample after which the plant counts as lost."""

_CALLER_NAME = "a person, by the live page"
_FILES = ("page.css", "page.js", "plots.js", "series.js", "uPlot.iife.min.js", "uPlot.min.css")
_SHOWN_TOPICS = (topics.STATE, topics.CORRECTION, topics.GAINS, topics.REFERENCE)
_NODES_MAX, _VALUES_MAX = 32, 60  # nodes whose diagnostics are kept, those heard last, and values of each


class SampleReceiver:
    """Subscribes to the topics published at every sample, and downsamples them for the page."""

    def __init__(self) -> None:
        self.mailbox = Mailbox("dashboard")
        qos = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._queues = {}
        for topic in (topics.STATE, topics.CORRECTION, topics.LAW_STATE):
            kind = topics.RECORDED_TOPICS[topic][0]
            self._queues[topic] = self.mailbox.subscribe(topic, kind, qos), fixed_layout(topics.type_name(kind))
        self._sequence = -1
        self.series = tuple(LiveSeries(len(columns)) for columns in SERIES_COLUMNS)
        self.decided: Counter[int] = Counter()
        """Number of corrections of each status since this was last cleared."""
        self.taken_at = self.compensated_at = -inf
        """s, monotonic time of the polls that received the last sample, and state of the compensated law."""
        self.flags = self.lost = 0
        """Flags of the last sample; number of samples missing in the sequence."""
        self.contested = False
        """Whether more than one plant publishes samples."""

    def poll(self, now: float) -> None:
        """Process all queued messages; `now`: monotonic time [s]."""
        self.contested = bool(self._queues[topics.STATE][0].get_publisher_count() > 1)
        for number, (topic, (subscription, layout)) in enumerate(self._queues.items()):
            messages = [data for data, _ in self.mailbox.fetch(subscription, QUEUE_DEPTH)]
            alike = [message for message in messages if len(message) == len(messages[-1])]
            if not alike:
                continue
            try:
                rows = np.frombuffer(b"".join(alike), np.uint8).reshape(len(alike), -1)
                table = layout.decode(rows, np.zeros(len(alike), np.int64))
            except ValueError:  # messages of another version
                continue
            if topic == topics.STATE:
                sequence = table["sequence"].astype(np.int64)
                gaps = np.diff(sequence, prepend=self._sequence if self._sequence >= 0 else sequence[0] - 1) - 1
                self.lost += int(gaps[(gaps > 0) & (gaps < 2**31)].sum())
                self.taken_at, self._sequence, self.flags = now, int(sequence[-1]), int(table["flags"][-1])
            elif topic == topics.CORRECTION:
                self.decided.update(table["status"].tolist())
            else:
                self.compensated_at = now
            self.series[number].add(table["time"], column_values(number, table))


class DashboardNode(Node):
    """Serves the live page: forwards messages of the graph to it, and its commands to the plant.

    `host`, `port`: address of the page. The node subscribes to the infrequent topics; `SampleReceiver` to the others.
    """

    def __init__(self, host: str, port: int | None) -> None:
        super().__init__("dashboard")
        self._samples = SampleReceiver()
        self._authority = self._word = Authority()
        self._box: dict[str, Any] = {}
        self._training: dict[str, Any] = {}
        self._curve = LearningCurve()
        self._nodes: dict[str, tuple[float, dict[str, Any]]] = {}  # time [s] and last status of each, by name
        self._frames = 0
        self._words_heard = create_subscription(self, topics.AUTHORITY, self._on_authority)
        subscribe_to_box(self, self._on_box)
        for topic, hear in ((topics.TRAINING, self._on_training), (topics.DIAGNOSTICS, self._on_diagnostics)):
            kind, offered = topics.RECORDED_TOPICS[topic]
            qos = QoSProfile(depth=offered.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
            self.create_subscription(kind, topic, hear, qos)
        self._claim = self.create_client(Claim, topics.CLAIM_SERVICE)
        self._override = self.create_client(OverrideGains, topics.OVERRIDE_SERVICE)
        self._end = self.create_client(Trigger, topics.END_SERVICE)
        self._freeze = self.create_client(SetBool, topics.FREEZE_SERVICE)
        self._token = secrets.token_urlsafe(9)  # for those who may do more than disarm
        page = environment("hydro_bridge", "pages/static").get_template("index.html").render(title="hydro")
        static = resources.files("hydro_bridge.pages") / "static"
        files = {f"/{name}": (static / name).read_bytes() for name in _FILES}
        self._server = PageServer(
            files | {"/": page.encode()}, answer_commands(self._execute), message_size_max=COMMAND_SIZE_MAX,
            policy="default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data:; "
            "connect-src 'self'", host=host, port=port,
        )  # fmt: skip
        self.create_timer(0.05, self._frame, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self._diagnostics = DiagnosticsPublisher(self, self._status)
        warn_of_duplicate_nodes(
            self, f"another live page runs here: both show the plant, this one at {self._server.address}"
        )
        request_realtime(realtime=False)
        print(f"the live page: {self._server.address}#token={self._token}", flush=True)

    def close(self) -> None:
        """Disconnect the viewers."""
        self._samples.mailbox.close()
        self._server.close()

    def _execute(self, command: PageCommand) -> Promise[tuple[bool, str]]:
        """Execute a command in the caller's thread; success and sentence follow later. Raises RefusedError."""
        authorize(command, self._token, int(self._authority.epoch))
        client, request, absent = self._call(command)
        if not client.service_is_ready():
            raise RefusedError(absent)
        if command.command != "disarm":
            self.get_logger().info(f"the page asks: {command.command}")
        told: Promise[tuple[bool, str]] = Promise()
        answer = client.call_async(request)

        def answered(done: Future) -> None:
            if not done.exception() and (response := done.result()) is not None:
                with suppress(InvalidStateError):  # cancelled by the time-out, in another thread
                    told.set_result((response.success, response.message))

        answer.add_done_callback(answered)
        told.add_done_callback(lambda _: client.remove_pending_request(answer))
        return told

    def _call(self, command: PageCommand) -> tuple[Client, object, str]:
        """Return the service of a command, the request, and the message for an absent service."""
        name, no_run = command.command, "nobody commands the plant: no run is active here"
        if name in ("disarm", "arm"):
            claim = Claim.Request(act=Claim.Request.DISARM, name=_CALLER_NAME)
            if name == "arm":
                claim.act, claim.epoch = Claim.Request.ARM, int(command.epoch)
            return self._claim, claim, "no plant runs here that could be told"
        if name == "end":
            return self._end, Trigger.Request(), no_run
        if name in ("freeze", "adapt"):
            no_estimator = "no run here fits the coefficients of the compensated law"
            return self._freeze, SetBool.Request(data=name == "freeze"), no_estimator
        gains = OverrideGains.Request(active=name == "override", name=_CALLER_NAME, whom=self._authority.holder)
        if gains.active:
            gains.proportional_gain, gains.integral_gain, gains.seconds = command.kp, command.ki, command.seconds
        return self._override, gains, no_run

    def _status(self) -> Status:
        values = {"address": self._server.address, "samples missed": self._samples.lost}
        return Status(message=f"viewers: {self._server.viewers}", values=values)

    def _frame(self) -> None:
        self._frames += 1
        viewers = self._server.viewers
        if not viewers and self._frames % 5:  # a quarter of a second, half of `QUEUE_DEPTH`
            return
        now = time.monotonic()
        self._samples.poll(now)
        self._believe()
        closed = [series.poll() for series in self._samples.series]
        frames: list[str | bytes] = [encode_bins(n, *bins) for n, bins in enumerate(closed) if len(bins[1])]
        if viewers:
            frames.append(encode_message("pulse", self._pulse(now)))
            if self._frames % 10 == 0:
                frames.append(encode_message("words", self._words(now)))
        self._server.publish(frames, partial(self._welcome, now))

    def _welcome(self, now: float) -> list[str | bytes]:
        """Return the initial content of a page: names and units, the last minute, the status texts."""
        return [
            encode_message("hello", {"bin_width": BIN_WIDTH, "series": column_descriptions()}),
            *(encode_bins(index, *series.history()) for index, series in enumerate(self._samples.series)),
            encode_message("pulse", self._pulse(now)),
            encode_message("words", self._words(now)),
        ]

    def _pulse(self, now: float) -> dict[str, Any]:
        age = now - self._samples.taken_at
        return {
            "age": round(age, 3) if age < inf else None,
            "alive": age < PLANT_TIMEOUT,
            "sent": round(1e3 * now),
            "contested": self._samples.contested,
            "flags": flag_labels(self._samples.flags),
            "epoch": str(self._authority.epoch),
            "holder": self._authority.holder,
        }

    def _words(self, now: float) -> dict[str, Any]:
        decided, self._samples.decided = self._samples.decided, Counter()
        publishers = {topic: self.get_publishers_info_by_topic(topic) for topic in _SHOWN_TOPICS}
        return {
            "box": self._box,
            "training": self._training,
            "curve": self._curve.content(),
            "filter": {known.name.lower(): decided[known] for known in CorrectionStatus if known in decided},
            "law": "compensated" if now - self._samples.compensated_at < PLANT_TIMEOUT else "paper",
            "nodes": [{**said, "age": round(now - heard, 1)} for _, (heard, said) in sorted(self._nodes.items())],
            "publishers": {topic: sorted({info.node_name for info in found}) for topic, found in publishers.items()},
            "missed": self._samples.lost,
            "viewers": self._server.viewers,
        }

    def _on_authority(self, message: Authority) -> None:
        self._word = message
        self._believe()

    def _believe(self) -> None:
        """Ignore the authority's messages of two plants; the latest counts once there is only one again."""
        if self._words_heard.get_publisher_count() <= 1:
            self._authority = self._word

    def _on_box(self, box: BoxDescription) -> None:
        self._box = {"plant": box.plant, "firmware": box.info.name, "bench": box.bench_digest}

    def _on_training(self, message: TrainingStatus) -> None:
        finished = (message.force_rmse, message.episode_return, message.critic_loss, message.actor_loss)
        self._curve.add(message.phase, message.episode, *finished)
        self._training = {
            "phase": PHASES[message.phase] if message.phase < len(PHASES) else str(message.phase),
            "episode": message.episode,
            "step": message.step,
            "return": message.episode_return,
            "rmse": message.force_rmse,
            "alpha": message.entropy_coefficient,
            "updates": message.updates,
            "learner": message.learner_alive,
        }

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        now = time.monotonic()
        for node in message.status:
            kept = {entry.key: entry.value for entry in node.values[:_VALUES_MAX]}
            level = int.from_bytes(node.level, "little")
            self._nodes.pop(node.name, None)
            self._nodes[node.name] = now, {"name": node.name, "level": level, "message": node.message, "values": kept}
            while len(self._nodes) > _NODES_MAX:
                del self._nodes[next(iter(self._nodes))]


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("dashboard", __doc__)
    parser.add_argument("--host", default=HOST, metavar="ADDRESS", help=f"to listen at (default {HOST}: here only)")
    parser.add_argument(
        "--port", type=bounded_number(0, 65535), metavar="N", help=f"default {PORT}, if taken a free one; 0: any"
    )
    own, ros = ros_arguments()
    options = parser.parse_args(own)
    run_node(partial(DashboardNode, options.host, options.port), ros)
