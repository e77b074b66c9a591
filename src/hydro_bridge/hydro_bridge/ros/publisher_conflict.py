# SPDX-License-Identifier: Apache-2.0
"""Topics that one node at a time may publish: two trainers' gains, or two plants' states, would alternate unnoticed.

Before a plant is armed it is enough that the graph shows two (`publisher_conflicts`). While it is armed a second
trainer may be there, silent, until it is alone: its gains have to be heard, too.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

from rclpy.node import Node
from rclpy.qos import QoSProfile

from hydro_bridge.ros.diagnostics import Level, Status
from hydro_bridge.ros.topics import GAINS, GRAPH, STATE

_TURNS = 2
"""Times that gains do not follow those before: a handover has one, two who alternate have many."""
_DEPTH = 200  # gains between two looks; of more the first are lost


def publisher_conflicts(node: Node, *topics: str) -> str:
    """A sentence about each topic that more than one publishes; empty if there is none."""
    crowded = []
    for topic in topics:
        if node.count_publishers(topic) > 1:
            names = sorted(info.node_name for info in node.get_publishers_info_by_topic(topic))
            crowded.append(f"{len(names)} nodes publish {topic} ({', '.join(names)}): end all but one")
    return "; ".join(crowded)


def with_publisher_conflicts(status: Status, trouble: str) -> Status:
    """The status, made an ERROR that says so if there is `trouble`."""
    if not trouble:
        return status
    return Status(level=Level.ERROR, message=f"{trouble}; {status.message}", values=status.values)


class PublisherConflictWatch:
    """Whether two nodes drive a plant that is armed, or two plants answer; look once a second.

    Whose gains a message holds it does not say, but the middleware numbers each publisher's messages one by one. They
    are read here by hand, out of a subscription that nobody spins: rclpy's EventsExecutor (7.1) cannot hand the numbers
    to a callback.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._ear = Node(
            f"_{node.get_name()}_ear",
            context=node.context,
            use_global_arguments=False,  # a node that was renamed would rename this one, too
            enable_rosout=False,
            start_parameter_services=False,
        )
        self._kind = GRAPH[GAINS][0]
        self._heard = self._ear.create_subscription(self._kind, GAINS, lambda _: None, QoSProfile(depth=_DEPTH))
        self._crowded, self._turns = False, 0
        self._last: list[int] = []  # the number that was read last, if there was one
        self._two_plants = ""

    def look(self) -> str:
        """Which nodes publish beside one another, in a sentence; empty if nobody does."""
        before, self._two_plants = self._two_plants, publisher_conflicts(self._node, STATE)
        return (self._two_plants if before else "") or self._two_voices()

    def close(self) -> None:
        """End it, before its node."""
        self._ear.destroy_node()

    def _two_voices(self) -> str:
        crowd = publisher_conflicts(self._node, GAINS)
        if not crowd:
            self._crowded, self._turns, self._last = False, 0, []
            return ""
        numbers = list(self._numbers())
        if len(numbers) < _DEPTH:  # none lost in between
            numbers = self._last + numbers
        if self._crowded:  # what came before it counts for nothing
            self._turns += sum(later != earlier + 1 for earlier, later in pairwise(numbers))
        self._crowded, self._last = True, numbers[-1:]
        return crowd if self._turns >= _TURNS else ""

    def _numbers(self) -> Iterator[int]:
        """Of the gains since the last look; all 0 where the middleware does not number: then two are two voices."""
        handle = self._heard.handle
        with handle:
            while (taken := handle.take_message(self._kind, False)) is not None:
                yield taken[1]["publication_sequence_number"] or 0
