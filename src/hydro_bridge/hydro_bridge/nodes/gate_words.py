# SPDX-License-Identifier: Apache-2.0
"""Announcements about the authority: its holder on /hydro/authority, grants and refusals in the log."""

from __future__ import annotations

from collections import Counter

from rclpy.node import Node

from hydro_bridge.ros.diagnostics import CALLS
from hydro_bridge.ros.topics import AUTHORITY, AUTHORITY_QOS, CORRECTION
from hydro_bridge.safety.authority import Authority
from hydro_msgs.msg import Authority as AuthorityMessage

_NEWCOMERS = 50
"""Corrections per second without the epoch that are not reported: those of a filter that has not received it yet."""


class GateWords:
    """Announces one authority.

    Parameters
    ----------
    node
        Node of the plant.
    authority
        Authority that is announced.
    """

    def __init__(self, node: Node, authority: Authority) -> None:
        self._node, self._authority = node, authority
        self._publisher = node.create_publisher(AuthorityMessage, AUTHORITY, AUTHORITY_QOS)
        self._told: Counter[str] = Counter()
        self._last = ""
        self._calls = node.get_logger().get_child(CALLS)

    def tell(self) -> None:
        """Publish the holder, and the epoch that commands must carry now."""
        authority = self._authority
        message = AuthorityMessage(holder=authority.holder, claim=authority.claim, epoch=authority.epoch)
        message.header.stamp = self._node.get_clock().now().to_msg()
        self._publisher.publish(message)
        self._last = ""

    def tell_refused(self) -> None:
        """Log how many commands were refused since the last call, and the publishers of these topics.

        The holder is announced again: messages of a restarted plant are ignored while its killed predecessor is still
        in the graph, and the new plant cannot know that.
        """
        news = self._authority.refused - self._told
        if news:
            self.tell()
        self._told = self._authority.refused.copy()
        if news[CORRECTION] <= _NEWCOMERS:
            del news[CORRECTION]
        for topic, count in news.items():
            names = sorted({info.node_name for info in self._node.get_publishers_info_by_topic(topic)})
            self._node.get_logger().warning(
                f"refused: {count} of {topic} without the authority over this plant (from {', '.join(names) or 'gone'})"
                ": the valve does not follow them; end what sends them, or wait until it has the authority"
            )

    def say(self, sentence: str) -> None:
        """Log a sentence."""
        self._node.get_logger().info(sentence)

    def called(self, who: str, answer: str) -> None:
        """Log a caller's request and the answer, once until either changes: some callers repeat their requests."""
        sentence = f"{who}: {answer}"
        if sentence != self._last:
            self._calls.info(sentence)
        self._last = sentence
