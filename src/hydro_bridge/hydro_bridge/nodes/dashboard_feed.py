# SPDX-License-Identifier: Apache-2.0
"""What the dashboard hears, made into frames for the page, 20 times a second.

Samples wait serialized in the middleware's queue until the next frame takes them all: nothing of ours runs at 1 kHz.
The queue is bounded and best-effort: whatever happens to this process, who publishes does not notice.
"""

from __future__ import annotations

import time
from collections import Counter
from functools import partial
from math import inf
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from hydro_bridge.dashboard import series, words
from hydro_bridge.dashboard.server import PageServer
from hydro_bridge.dashboard.thinning import SLOT, Thinner
from hydro_bridge.ros import (
    AUTHORITY,
    AUTHORITY_QOS,
    CORRECTION,
    DIAGNOSTICS,
    GAINS,
    GRAPH,
    REFERENCE,
    STATE,
    TRAINING,
    listen_to_box,
)
from hydro_bridge.safety.box_info import KnownBox
from hydro_msgs.msg import Authority, TrainingStatus

PERIOD = 0.05
"""s between two frames."""
QUEUE = 500
"""Messages per topic that wait for the next frame: half a second."""

_WORDS_EVERY = 10  # frames: twice a second
_SHOWN = (STATE, CORRECTION, GAINS, REFERENCE)
_NO_SERVICES = Parameter("start_type_description_service", value=False)


class Feed:
    """Hears the graph, and keeps what a page shows.

    Parameters
    ----------
    node
        Hears what is rare; 1 kHz goes to a node of its own that is never spun.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._listener = Node(
            "dashboard_samples",
            use_global_arguments=False,
            enable_rosout=False,
            start_parameter_services=False,
            parameter_overrides=[_NO_SERVICES],
        )
        self._states, self._corrections = self._queued(STATE), self._queued(CORRECTION)
        self._decode_states = series.Decoder(series.STATE_TYPE)
        self._decode_corrections = series.Decoder(series.CORRECTION_TYPE)
        self._state_series = Thinner(len(series.STATE_COLUMNS) + len(series.STATE_EXTRA))
        self._correction_series = Thinner(len(series.CORRECTION_COLUMNS))
        self._authority = self._word = Authority()
        self._box: dict[str, Any] = {}
        self._training: dict[str, Any] = {}
        self._curve, self._nodes, self._decided = words.Curve(), words.Nodes(), words.FilterCounts()
        self._sampled, self._sequence, self._flags = -inf, -1, 0
        self._samples = self._lost = self._frames = 0
        self._server: PageServer | None = None
        self._words_heard = node.create_subscription(Authority, AUTHORITY, self._on_authority, AUTHORITY_QOS)
        listen_to_box(node, self._on_box)
        node.create_subscription(TrainingStatus, TRAINING, self._on_training, _best_effort(TRAINING))
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, _best_effort(DIAGNOSTICS))

    @property
    def epoch(self) -> int:
        """Of the plant's session; 0: no plant has said it."""
        return int(self._authority.epoch)

    @property
    def holder(self) -> str:
        """Name of who commands the plant; empty: nobody."""
        return str(self._authority.holder)

    def serve(self, server: PageServer) -> None:
        """From now on give `server` its frames."""
        self._server = server
        self._node.create_timer(PERIOD, self._frame, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def counts(self) -> dict[str, object]:
        """For /diagnostics."""
        return {"frames": self._frames, "samples": self._samples, "samples missed": self._lost}

    def close(self) -> None:
        """Leave the graph."""
        self._listener.destroy_node()

    def _queued(self, topic: str) -> Subscription:
        qos = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.BEST_EFFORT)
        return self._listener.create_subscription(GRAPH[topic][0], topic, _never, qos, raw=True)

    def _frame(self) -> None:
        now = time.monotonic()
        self._take_states(now)
        self._take_corrections()
        self._believe()
        self._frames += 1
        if self._server is None:
            return
        frames: list[str | bytes] = []
        for number, thinned in enumerate((self._state_series, self._correction_series)):
            slots = thinned.take()
            if self._server.viewers and len(slots.values):
                frames.append(slots.encoded(number))
        if self._server.viewers:
            frames.append(words.encoded("pulse", self._pulse(now)))
            if self._frames % _WORDS_EVERY == 0:
                frames.append(words.encoded("words", self._words(now)))
        self._server.publish(frames, partial(self._welcome, now))

    def _welcome(self, now: float) -> list[str | bytes]:
        """What a page needs first: names and units, the last minute, the words."""
        hello = {"slot": SLOT, "series": series.described()}
        told: list[str | bytes] = [words.encoded("hello", hello)]
        for number, thinned in enumerate((self._state_series, self._correction_series)):
            told.append(thinned.history().encoded(number))
        return [*told, words.encoded("pulse", self._pulse(now)), words.encoded("words", self._words(now))]

    def _pulse(self, now: float) -> dict[str, Any]:
        age = now - self._sampled
        return {
            "age": round(age, 3) if age < inf else None,
            "alive": age < words.DEAD_AFTER,
            "sent": round(1e3 * now),
            "contested": self._states.get_publisher_count() > 1,
            "flags": words.flag_words(self._flags),
            "epoch": str(self.epoch),
            "holder": self.holder,
        }

    def _words(self, now: float) -> dict[str, Any]:
        published = {topic: sorted({info.node_name for info in self._publishers(topic)}) for topic in _SHOWN}
        return {
            "box": self._box,
            "training": self._training,
            "curve": self._curve.content(),
            "filter": self._decided.take(),
            "nodes": self._nodes.content(now),
            "publishers": published,
            "missed": self._lost,
            "viewers": self._server.viewers if self._server else 0,
        }

    def _publishers(self, topic: str) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(topic))

    def _take_states(self, now: float) -> None:
        messages = _all(self._states)
        if not messages:
            return
        try:
            table = self._decode_states.table(messages)
        except ValueError:  # another plant's version: no sample that we know
            return
        sequence = table["sequence"].astype(np.int64)
        gaps = np.diff(sequence, prepend=self._sequence if self._sequence >= 0 else sequence[0] - 1) - 1
        self._lost += int(gaps[(gaps > 0) & (gaps < 2**31)].sum())
        self._samples += len(table)
        self._sampled, self._sequence, self._flags = now, int(sequence[-1]), int(table["flags"][-1])
        self._state_series.add(table["time"], series.state_values(table))

    def _take_corrections(self) -> None:
        messages = _all(self._corrections)
        if not messages:
            return
        try:
            table = self._decode_corrections.table(messages)
        except ValueError:
            return
        self._decided.add(Counter(table["status"].tolist()))
        self._correction_series.add(table["time"], series.correction_values(table))

    def _on_authority(self, message: Authority) -> None:
        self._word = message
        self._believe()

    def _believe(self) -> None:
        """Of two plants none is believed; the last word counts once there is one again."""
        if self._words_heard.get_publisher_count() <= 1:
            self._authority = self._word

    def _on_box(self, box: KnownBox) -> None:
        info = box.info
        self._box = {
            "plant": box.plant,
            "firmware": info.name,
            "bench": box.bench_digest,
            "base_kp": info.base_kp,
            "base_ki": info.base_ki,
            "kp_max": info.base_kp + info.delta_kp_max,
            "ki_max": info.base_ki + info.delta_ki_max,
            "current_max": 1e3 * info.valve_current_max,
        }

    def _on_training(self, message: TrainingStatus) -> None:
        phase = words.PHASES[message.phase] if message.phase < len(words.PHASES) else str(message.phase)
        self._curve.add(message.episode, message.force_rmse, message.episode_return)
        self._training = {
            "phase": phase,
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
        for status in message.status:
            values = {entry.key: entry.value for entry in status.values}
            self._nodes.hear(status.name, int.from_bytes(status.level, "little"), status.message, values, now)


def _all(subscription: Subscription) -> list[bytes]:
    """What waits, at most one queue of it."""
    messages: list[bytes] = []
    with subscription.handle:
        while len(messages) < QUEUE and (taken := subscription.handle.take_message(subscription.msg_type, True)):
            messages.append(taken[0])
    return messages


def _best_effort(topic: str) -> QoSProfile:
    offered = GRAPH[topic][1]
    return QoSProfile(depth=offered.depth, reliability=ReliabilityPolicy.BEST_EFFORT)


def _never(_: object) -> None:
    """Nobody spins the node of the samples."""
