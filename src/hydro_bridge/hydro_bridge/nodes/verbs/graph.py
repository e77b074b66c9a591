# SPDX-License-Identifier: Apache-2.0
"""Temporary access to the graph: a hidden node for the duration of one verb, and waiting for discovery."""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import rclpy
from rclpy.node import Node
from rclpy.task import Future

from hydro_bridge.cli.console import UserError
from hydro_bridge.ros.node import start_ros

SPIN_TIME = 1.0
"""s, minimum wait of a list, which continues until nothing new has appeared for `_CALM`."""
PATIENCE = 10.0
"""s, wait for a named item: on a busy machine announcements get lost and are repeated every few seconds."""
_CALM = 0.5
_LOOK = 0.05


def add_spin_time(parser: argparse.ArgumentParser) -> None:
    """Add `--spin-time S`, upstream's option."""
    parser.add_argument(
        "--spin-time", type=float, default=SPIN_TIME, metavar="S", help=f"s to look around at least ({SPIN_TIME:g})"
    )


def add_list_options(parser: argparse.ArgumentParser, things: str) -> None:
    """Add upstream's options of a list of `things`."""
    parser.add_argument("-t", "--show-types", action="store_true", help="with their types")
    parser.add_argument("-c", f"--count-{things}", dest="count", action="store_true", help="only how many")
    parser.add_argument(
        f"--include-hidden-{things}", dest="include_hidden", action="store_true", help="hidden ones, too"
    )
    add_spin_time(parser)


def print_list(options: argparse.Namespace, found: Iterable[tuple[str, list[str]]]) -> None:
    """Print names, with their types if requested; `options` are those of `add_list_options`."""
    shown = sorted((name, kinds) for name, kinds in found if options.include_hidden or not hidden(name))
    if options.count:
        print(len(shown))
        return
    for name, kinds in shown:
        print(f"{name} [{', '.join(kinds)}]" if options.show_types else name)


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


def settle(node: Node, spin_time: float) -> None:
    """Wait until the graph no longer changes: at least `spin_time` s, at most `PATIENCE` more."""
    begin = time.monotonic()
    seen, changed = -1, begin
    while (now := time.monotonic()) < begin + spin_time or (now < changed + _CALM and now < begin + PATIENCE):
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


def full_name(namespace: str, name: str) -> str:
    """`/namespace/name`."""
    return f"{namespace.rstrip('/')}/{name}"


def absolute(name: str) -> str:
    """Return a name with its leading slash."""
    return name if name.startswith("/") else f"/{name}"


def hidden(name: str) -> bool:
    """Return whether one of a name's parts begins with `_`."""
    return any(part.startswith("_") for part in name.split("/"))
