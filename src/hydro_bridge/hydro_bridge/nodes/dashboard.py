# SPDX-License-Identifier: Apache-2.0
"""Serves the live page of the graph that runs: look at it, disarm it; with the token, arm and override it.

ros2 run hydro_bridge dashboard                  # prints the page's address, with the token behind #
ros2 run hydro_bridge dashboard --port 8080
"""

from __future__ import annotations

import asyncio
import secrets
import time
from collections import Counter
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
from std_srvs.srv import SetBool, Trigger

from hydro_bridge.arguments import parse_arguments, ros_arguments
from hydro_bridge.bags.cdr import fixed_layout
from hydro_bridge.pages import environment, series
from hydro_bridge.pages.commands import COMMAND_SIZE_MAX, PageCommand, answer_commands, authorize
from hydro_bridge.pages.marks import flag_labels
from hydro_bridge.pages.server import HOST, PORT, PageServer, encode_message
from hydro_bridge.ros import topics
from hydro_bridge.ros.messages import subscribe_to_box
from hydro_bridge.ros.node import run_node
from hydro_bridge.ros.topics import Mailbox, create_subscription
from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.cli.console import bounded_number, command, make_parser
from hydro_core.errors import UserError
from hydro_core.signals import CorrectionStatus
from hydro_msgs.msg import Authority, TrainingStatus
from hydro_msgs.srv import Claim, OverrideGains

QUEUE_DEPTH = 500
"""Depth of the message queue of each topic until the next frame: half a second."""
PLANT_TIMEOUT = 0.5
"""s without a sample after which the plant counts as lost."""

_SHOWN_TOPICS = (topics.STATE, topics.CORRECTION, topics.GAINS, topics.REFERENCE)
_POLICY = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data:; connect-src 'self'"


class SampleReceiver:
    """Subscribes to the topics published at every sample, and downsamples them for the page."""

    def __init__(self) -> None:
        self.mailbox = Mailbox("dashboard")
        qos = QoSProfile(depth=QUEUE_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
        self._queues = {}
        for topic in (topics.STATE, topics.CORRECTION, topics.LAW_STATE):
            kind = topics.RECORDED_TOPICS[topic][0]
            self._queues[topic] = self.mailbox.subscribe(topic, kind, qos), fixed_layout(topics.type_name(kind))
        self._sequence: int | None = None
        self.series = tuple(series.LiveSeries(len(columns)) for columns in series.SERIES_COLUMNS)
        self.decided: Counter[int] = Counter()
        """Number of corrections of each status since this was last cleared."""
        self.taken_at = self.compensated_at = -inf
        """s, monotonic time of the polls that received the last sample, and state of the compensated law."""
        self.flags = self.lost = 0
        """Flags of the last sample; number of samples missing in the sequence."""

    def poll(self, now: float) -> None:
        """Process all queued messages; `now`: monotonic time [s]."""
        for number, (topic, (subscription, layout)) in enumerate(self._queues.items()):
            messages = [data for data, _ in self.mailbox.fetch(subscription, QUEUE_DEPTH)]
            alike = [message for message in messages if len(message) == len(messages[-1])]
            if not alike:
                continue
            rows = np.frombuffer(b"".join(alike), np.uint8).reshape(len(alike), -1)
            try:
                table = layout.decode(rows, np.zeros(len(alike), np.int64))
            except ValueError:  # anybody may publish bytes that are no message
                continue
            if topic == topics.STATE:
                sequence = table["sequence"].astype(np.int64)
                gaps = np.diff(sequence, prepend=sequence[0] - 1 if self._sequence is None else self._sequence) - 1
                self.lost += int(gaps[(gaps > 0) & (gaps < 2**31)].sum())
                self.taken_at, self._sequence, self.flags = now, int(sequence[-1]), int(table["flags"][-1])
            elif topic == topics.CORRECTION:
                self.decided.update(table["status"].tolist())
            else:
                self.compensated_at = now
            self.series[number].add(table["time"], series.column_values(number, table))


class DashboardNode(Node):
    """Serves the live page: forwards messages of the graph to it, and its commands to the plant.

    `host`, `port`: address of the page. The node subscribes to the infrequent topics; `SampleReceiver` to the others.
    """

    def __init__(self, host: str, port: int | None) -> None:
        super().__init__("dashboard")
        self._samples, self._curve = SampleReceiver(), series.LearningCurve()
        self._authority = Authority()
        self._box: BoxDescription | None = None
        self._training: dict[str, Any] = {}
        self._nodes: dict[str, tuple[float, dict[str, Any]]] = {}  # time [s] and last status of each, by name
        self._frames = 0
        create_subscription(self, topics.AUTHORITY, partial(setattr, self, "_authority"))
        subscribe_to_box(self, partial(setattr, self, "_box"))
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
        files = {"/": page.encode(), **{f"/{file.name}": file.read_bytes() for file in static.iterdir()}}
        attend = partial(answer_commands, execute=self._execute)
        self._server = PageServer(
            files, attend, policy=_POLICY, message_size_max=COMMAND_SIZE_MAX, host=host, port=port
        )
        self.create_timer(0.05, self._frame, clock=Clock(clock_type=ClockType.STEADY_TIME))
        print(f"the live page: {self._server.address}#token={self._token}", flush=True)

    def close(self) -> None:
        """Disconnect the viewers."""
        self._samples.mailbox.close()
        self._server.close()

    async def _execute(self, command: PageCommand) -> tuple[bool, str]:
        """Execute a command; returns success and a sentence. Raises UserError."""
        authorize(command, self._token, int(self._authority.epoch))
        client, request = self._call(command)
        if not client.service_is_ready():
            raise UserError(f"nothing was done: no node here offers {client.srv_name}")
        answer = client.call_async(request)
        try:
            while not answer.done():
                await asyncio.sleep(0.005)
        finally:
            client.remove_pending_request(answer)
        return answer.result().success, answer.result().message

    def _call(self, command: PageCommand) -> tuple[Client, object]:
        """Return the service of a command, and the request."""
        name, caller = command.command, "a person, by the live page"
        if name == "disarm":
            return self._claim, Claim.Request(act=Claim.Request.DISARM, name=caller)
        if name == "arm":
            return self._claim, Claim.Request(act=Claim.Request.ARM, name=caller, epoch=int(command.epoch))
        if name == "end":
            return self._end, Trigger.Request()
        if name in ("freeze", "adapt"):
            return self._freeze, SetBool.Request(data=name == "freeze")
        gains = OverrideGains.Request(active=name == "override", name=caller, whom=self._authority.holder)
        if gains.active:
            gains.proportional_gain, gains.integral_gain, gains.seconds = command.kp, command.ki, command.seconds
        return self._override, gains

    def _frame(self) -> None:
        self._frames += 1
        if not self._server.viewers and self._frames % 5:  # a quarter of a second, half of `QUEUE_DEPTH`
            return
        now = time.monotonic()
        self._samples.poll(now)
        closed = [live.poll() for live in self._samples.series]
        bins = [series.encode_bins(n, *bins) for n, bins in enumerate(closed) if len(bins[1])]
        words = [self._words(now)] if self._server.viewers and self._frames % 10 == 0 else []
        self._server.publish([*bins, self._pulse(now), *words], lambda: self._welcome(now))

    def _welcome(self, now: float) -> list[str | bytes]:
        """Return the initial content of a page: names and units, the last minute, the status texts."""
        return [
            encode_message("hello", bin_width=series.BIN_WIDTH, series=series.SERIES_COLUMNS),
            *(series.encode_bins(n, *live.history()) for n, live in enumerate(self._samples.series)),
            self._pulse(now),
            self._words(now),
        ]

    def _pulse(self, now: float) -> str:
        age = now - self._samples.taken_at
        return encode_message(
            "pulse",
            age=round(age, 3) if age < inf else None,
            alive=age < PLANT_TIMEOUT,
            sent=round(1e3 * now),
            contested=self.count_publishers(topics.STATE) > 1,
            flags=flag_labels(self._samples.flags),
            epoch=str(self._authority.epoch),
            holder=self._authority.holder,
        )

    def _words(self, now: float) -> str:
        decided, self._samples.decided = self._samples.decided, Counter()
        box = self._box
        publishers = {topic: self.get_publishers_info_by_topic(topic) for topic in _SHOWN_TOPICS}
        return encode_message(
            "words",
            box={"plant": box.plant, "firmware": box.info.name, "bench": box.bench_digest} if box else {},
            training=self._training,
            curve=self._curve.content(),
            filter={known.name.lower(): decided[known] for known in CorrectionStatus if known in decided},
            law="compensated" if now - self._samples.compensated_at < PLANT_TIMEOUT else "paper",
            nodes=[{**said, "age": round(now - heard, 1)} for _, (heard, said) in sorted(self._nodes.items())],
            publishers={topic: sorted({info.node_name for info in found}) for topic, found in publishers.items()},
            missed=self._samples.lost,
            viewers=self._server.viewers,
        )

    def _on_training(self, message: TrainingStatus) -> None:
        self._curve.add(message)
        shown = ("episode", "step", "episode_return", "force_rmse", "entropy_coefficient", "updates", "learner_alive")
        phase = series.PHASES[message.phase]
        self._training = {"phase": phase, **{field: getattr(message, field) for field in shown}}

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for node in message.status:
            values = {entry.key: entry.value for entry in node.values}
            said = {"name": node.name, "level": node.level[0], "message": node.message, "values": values}
            self._nodes[node.name] = time.monotonic(), said


@command()
def main() -> None:
    """Entry point."""
    parser = make_parser("dashboard", __doc__)
    parser.add_argument("--host", default=HOST, metavar="ADDRESS", help=f"to listen at (default {HOST}: here only)")
    parser.add_argument(
        "--port", type=bounded_number(0, 65535), metavar="N", help=f"default {PORT}, if taken a free one; 0: any"
    )
    own, ros = ros_arguments()
    options = parse_arguments(parser, "dashboard", own, ros)
    run_node(partial(DashboardNode, options.host, options.port), ros, [options])
