# SPDX-License-Identifier: Apache-2.0
"""Conversion of received messages into frames for the page, 20 times a second."""

from __future__ import annotations

import time
from collections import Counter
from functools import partial
from math import inf
from typing import Any

import numpy as np
import numpy.typing as npt
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from hydro_bridge.dashboard import series, status
from hydro_bridge.dashboard.series import SLOT, Thinner
from hydro_bridge.dashboard.server import PageServer
from hydro_bridge.ros.messages import subscribe_to_box
from hydro_bridge.ros.topics import (
    AUTHORITY,
    CORRECTION,
    DIAGNOSTICS,
    GAINS,
    GRAPH,
    LAW_STATE,
    REFERENCE,
    STATE,
    TRAINING,
    Mailbox,
    create_subscription,
)
from hydro_bridge.safety.box_info import KnownBox
from hydro_msgs.msg import Authority, TrainingStatus

QUEUE = 500
"""Messages per topic that wait for the next frame: half a second."""


class Samples:
    """Takes the messages received since the last frame."""

    def __init__(self) -> None:
        self._mailbox = Mailbox("dashboard")
        self._states, self._corrections = self._queued(STATE), self._queued(CORRECTION)
        self._decode_states = series.Decoder(series.STATE_TYPE)
        self._decode_corrections = series.Decoder(series.CORRECTION_TYPE)
        self._laws, self._decode_laws = self._queued(LAW_STATE), series.Decoder(series.LAW_TYPE)
        self._sequence = -1
        self.series = tuple(Thinner(len(columns)) for columns in series.SERIES)
        """Thinners of the samples, of the corrections and of the compensated law."""
        self.decided = status.FilterCounts()
        self.taken_at = -inf
        """s, monotonic time at which the last sample was taken."""
        self.compensated_at = -inf
        """s, monotonic time at which the compensated law acted last."""
        self.flags = 0
        """Flags of the last sample."""
        self.count = 0
        self.lost = 0
        """Samples missing in the sequence."""

    @property
    def contested(self) -> bool:
        """Whether more than one plant publishes samples."""
        return bool(self._states.get_publisher_count() > 1)

    def take(self, now: float) -> None:
        """Take all queued messages at `now` [s, monotonic]."""
        self._take_states(now)
        self._take_corrections()
        if (table := self._fetched(self._decode_laws, self._laws)) is not None:
            self.compensated_at = now
            self.series[2].add(table["time"], series.values(series.LAW_COLUMNS, table))

    def close(self) -> None:
        """Leave the graph."""
        self._mailbox.close()

    def _queued(self, topic: str) -> Subscription:
        qos = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.BEST_EFFORT)
        return self._mailbox.subscribe(topic, GRAPH[topic][0], qos)

    def _fetched(self, decoder: series.Decoder, subscription: Subscription) -> npt.NDArray[np.void] | None:
        """Return the queued messages as a table; None if there are none, or of a plant of another version."""
        messages = [data for data, _ in self._mailbox.fetch(subscription, QUEUE)]
        try:
            return decoder.table(messages) if messages else None
        except ValueError:  # unknown layout
            return None

    def _take_states(self, now: float) -> None:
        table = self._fetched(self._decode_states, self._states)
        if table is None:
            return
        sequence = table["sequence"].astype(np.int64)
        gaps = np.diff(sequence, prepend=self._sequence if self._sequence >= 0 else sequence[0] - 1) - 1
        self.lost += int(gaps[(gaps > 0) & (gaps < 2**31)].sum())
        self.count += len(table)
        self.taken_at, self._sequence, self.flags = now, int(sequence[-1]), int(table["flags"][-1])
        self.series[0].add(table["time"], series.state_values(table))

    def _take_corrections(self) -> None:
        table = self._fetched(self._decode_corrections, self._corrections)
        if table is None:
            return
        self.decided.add(Counter(table["status"].tolist()))
        self.series[1].add(table["time"], series.values(series.CORRECTION_COLUMNS, table))


PERIOD = 0.05
"""s between two frames."""

_WORDS_EVERY = 10  # frames: twice a second
_UNWATCHED = 5  # frames between two of a page without viewers: a quarter of a second, half of `QUEUE`
_SHOWN = (STATE, CORRECTION, GAINS, REFERENCE)


class Feed:
    """Subscribes to the graph and keeps the data that a page shows.

    `node`: subscribes to the infrequent topics; `Samples` to the others.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._samples = Samples()
        self._authority = self._word = Authority()
        self._box: dict[str, Any] = {}
        self._training: dict[str, Any] = {}
        self._curve, self._nodes = status.Curve(), status.Nodes()
        self._frames = 0
        self._server: PageServer | None = None
        self._words_heard = create_subscription(node, AUTHORITY, self._on_authority)
        subscribe_to_box(node, self._on_box)
        node.create_subscription(TrainingStatus, TRAINING, self._on_training, _best_effort(TRAINING))
        node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._on_diagnostics, _best_effort(DIAGNOSTICS))

    @property
    def epoch(self) -> int:
        """Epoch of the plant's session; 0: not announced."""
        return int(self._authority.epoch)

    @property
    def holder(self) -> str:
        """Name of the node that commands the plant; empty: none."""
        return str(self._authority.holder)

    def serve(self, server: PageServer) -> None:
        """Start sending frames to `server`."""
        self._server = server
        self._node.create_timer(PERIOD, self._frame, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def counts(self) -> dict[str, object]:
        """Counts for /diagnostics."""
        return {"frames": self._frames, "samples": self._samples.count, "samples missed": self._samples.lost}

    def close(self) -> None:
        """Leave the graph."""
        self._samples.close()

    def _frame(self) -> None:
        self._frames += 1
        if self._server is None or not (self._server.viewers or self._frames % _UNWATCHED == 0):
            return
        now = time.monotonic()
        self._samples.take(now)
        self._believe()
        frames: list[str | bytes] = []
        for number, thinned in enumerate(self._samples.series):
            slots = thinned.take()
            if self._server.viewers and len(slots.values):
                frames.append(slots.encoded(number))
        if self._server.viewers:
            frames.append(status.encoded("pulse", self._pulse(now)))
            if self._frames % _WORDS_EVERY == 0:
                frames.append(status.encoded("words", self._words(now)))
        self._server.publish(frames, partial(self._welcome, now))

    def _welcome(self, now: float) -> list[str | bytes]:
        """Return the initial content of a page: names and units, the last minute, the status texts."""
        hello = {"slot": SLOT, "series": series.described()}
        told: list[str | bytes] = [status.encoded("hello", hello)]
        for number, thinned in enumerate(self._samples.series):
            told.append(thinned.history().encoded(number))
        return [*told, status.encoded("pulse", self._pulse(now)), status.encoded("words", self._words(now))]

    def _pulse(self, now: float) -> dict[str, Any]:
        age = now - self._samples.taken_at
        return {
            "age": round(age, 3) if age < inf else None,
            "alive": age < status.DEAD_AFTER,
            "sent": round(1e3 * now),
            "contested": self._samples.contested,
            "flags": status.flag_labels(self._samples.flags),
            "epoch": str(self.epoch),
            "holder": self.holder,
        }

    def _words(self, now: float) -> dict[str, Any]:
        published = {topic: sorted({info.node_name for info in self._publishers(topic)}) for topic in _SHOWN}
        return {
            "box": self._box,
            "training": self._training,
            "curve": self._curve.content(),
            "filter": self._samples.decided.take(),
            "law": "compensated" if now - self._samples.compensated_at < status.DEAD_AFTER else "paper",
            "nodes": self._nodes.content(now),
            "publishers": published,
            "missed": self._samples.lost,
            "viewers": self._server.viewers if self._server else 0,
        }

    def _publishers(self, topic: str) -> list[Any]:
        return list(self._node.get_publishers_info_by_topic(topic))

    def _on_authority(self, message: Authority) -> None:
        self._word = message
        self._believe()

    def _believe(self) -> None:
        """Ignore the authority's messages of two plants; the latest counts once there is only one again."""
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
        phase = status.PHASES[message.phase] if message.phase < len(status.PHASES) else str(message.phase)
        finished = (message.force_rmse, message.episode_return, message.critic_loss, message.actor_loss)
        self._curve.add(message.phase, message.episode, *finished)
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
        for node in message.status:
            values = {entry.key: entry.value for entry in node.values}
            self._nodes.update(node.name, int.from_bytes(node.level, "little"), node.message, values, now)


def _best_effort(topic: str) -> QoSProfile:
    offered = GRAPH[topic][1]
    return QoSProfile(depth=offered.depth, reliability=ReliabilityPolicy.BEST_EFFORT)
