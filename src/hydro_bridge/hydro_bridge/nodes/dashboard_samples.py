# SPDX-License-Identifier: Apache-2.0
"""Samples and corrections received by the dashboard: the series of its plots, and their counts.

They stay serialized in the middleware's queue until the next frame takes them all, so that no callback runs at 1 kHz.
The queue is bounded and best-effort: this process cannot affect the publishers.
"""

from __future__ import annotations

from collections import Counter
from math import inf

import numpy as np
import numpy.typing as npt
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from hydro_bridge.dashboard import series, words
from hydro_bridge.dashboard.thinning import Thinner
from hydro_bridge.ros.topics import CORRECTION, GRAPH, LAW_STATE, STATE

QUEUE = 500
"""Messages per topic that wait for the next frame: half a second."""

_NO_SERVICES = Parameter("start_type_description_service", value=False)


class Samples:
    """Takes the messages received since the last frame, through a separate node that is never spun."""

    def __init__(self) -> None:
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
        self._laws, self._decode_laws = self._queued(LAW_STATE), series.Decoder(series.LAW_TYPE)
        self._sequence = -1
        self.series = (
            Thinner(len(series.STATE_COLUMNS) + len(series.STATE_EXTRA)),
            Thinner(len(series.CORRECTION_COLUMNS)),
            Thinner(len(series.LAW_COLUMNS)),
        )
        """Thinners of the samples, of the corrections and of the compensated law."""
        self.decided = words.FilterCounts()
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
        if (table := _decoded(self._decode_laws, _all(self._laws))) is not None:
            self.compensated_at = now
            self.series[2].add(table["time"], series.values(series.LAW_COLUMNS, table))

    def close(self) -> None:
        """Leave the graph."""
        self._listener.destroy_node()

    def _queued(self, topic: str) -> Subscription:
        qos = QoSProfile(depth=QUEUE, reliability=ReliabilityPolicy.BEST_EFFORT)
        return self._listener.create_subscription(GRAPH[topic][0], topic, _never, qos, raw=True)

    def _take_states(self, now: float) -> None:
        table = _decoded(self._decode_states, _all(self._states))
        if table is None:
            return
        sequence = table["sequence"].astype(np.int64)
        gaps = np.diff(sequence, prepend=self._sequence if self._sequence >= 0 else sequence[0] - 1) - 1
        self.lost += int(gaps[(gaps > 0) & (gaps < 2**31)].sum())
        self.count += len(table)
        self.taken_at, self._sequence, self.flags = now, int(sequence[-1]), int(table["flags"][-1])
        self.series[0].add(table["time"], series.state_values(table))

    def _take_corrections(self) -> None:
        table = _decoded(self._decode_corrections, _all(self._corrections))
        if table is None:
            return
        self.decided.add(Counter(table["status"].tolist()))
        self.series[1].add(table["time"], series.values(series.CORRECTION_COLUMNS, table))


def _all(subscription: Subscription) -> list[bytes]:
    """Return the queued messages, at most one queue of them."""
    messages: list[bytes] = []
    with subscription.handle:
        while len(messages) < QUEUE and (taken := subscription.handle.take_message(subscription.msg_type, True)):
            messages.append(taken[0])
    return messages


def _decoded(decoder: series.Decoder, messages: list[bytes]) -> npt.NDArray[np.void] | None:
    """Return the messages as a table; None if there are none, or of a plant of another version."""
    try:
        return decoder.table(messages) if messages else None
    except ValueError:  # unknown layout
        return None


def _never(_: object) -> None:
    """Callback that is never called: the node of the samples is not spun."""
