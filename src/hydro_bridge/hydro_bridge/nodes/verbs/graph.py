# SPDX-License-Identifier: Apache-2.0
"""Access to the graph for one verb: a hidden node for its duration, discovery, and names."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node
from rclpy.task import Future

from hydro_bridge.cli.console import UserError
from hydro_bridge.ros.node import start_ros

_SPIN_TIME = 1.0
"""s, minimum wait of a list, which continues until nothing new has appeared for `_CALM`."""
PATIENCE = 10.0
"""s, wait for a named item: on a busy machine announcements get lost and are repeated every few seconds."""
_CALM = 0.5
_LOOK = 0.05


@contextmanager
def visiting() -> Iterator[Node]:
    """Yield a node that offers nothing and is hidden from lists by the leading `_` of its name."""
    start_ros()
    node = Node(f"_ros2cli_{os.getpid()}", start_parameter_services=False, enable_rosout=False)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown()


def settle(node: Node) -> None:
    """Wait until the graph no longer changes: at least `_SPIN_TIME`, at most `PATIENCE`."""
    begin = time.monotonic()
    seen, changed = -1, begin
    while (now := time.monotonic()) < begin + _SPIN_TIME or (now < changed + _CALM and now < begin + PATIENCE):
        count = sum(1 for _ in node.get_node_names_and_namespaces()) + len(node.get_topic_names_and_types())
        if count != seen:
            seen, changed = count, now
        time.sleep(_LOOK)


def wait_for(condition: Callable[[], object], sentence: str, patience: float = PATIENCE) -> None:
    """Wait until `condition` holds; raises UserError with `sentence` after `patience` s."""
    end = time.monotonic() + patience
    while not condition():
        if time.monotonic() > end:
            raise UserError(f"{sentence} (looked for {patience:g} s)")
        time.sleep(_LOOK)


def answer_of(node: Node, answer: Future, who: str) -> object:
    """Return the answer of a service; raises UserError if there is none within `PATIENCE`."""
    rclpy.spin_until_future_complete(node, answer, timeout_sec=PATIENCE)
    if not answer.done():
        raise UserError(f"{who} gave no answer within {PATIENCE:g} s")
    return answer.result()


def absolute(name: str) -> str:
    """Return a name with its leading slash."""
    return name if name.startswith("/") else f"/{name}"


def hidden(name: str) -> bool:
    """Return whether one of a name's parts begins with `_`."""
    return any(part.startswith("_") for part in name.split("/"))


def node_names(node: Node) -> list[str]:
    """Return the full names of all nodes, sorted."""
    return sorted(f"{namespace.rstrip('/')}/{name}" for name, namespace in node.get_node_names_and_namespaces())


def find_node(node: Node, wanted: str) -> str:
    """Return the full name of a node once it is found; raises UserError."""
    wanted = absolute(wanted)
    wait_for(lambda: wanted in node_names(node), f"there is no node {wanted}")
    return wanted


def types_of(offered: Callable[[], list[tuple[str, list[str]]]], name: str, sentence: str) -> list[str]:
    """Return the types of a topic or service once it is in the graph; raises UserError with `sentence`."""
    wait_for(lambda: name in dict(offered()), sentence)
    return list(dict(offered())[name])
